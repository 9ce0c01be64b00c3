"""A controller of one's own that prints columns: whole lines only, times with their uncertainty."""

from __future__ import annotations

import contextlib
import json
import os
import re
import threading
import time
import tty
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from analysis.registry import analysis_of
from analysis.reporting.derived import derive_all
from analysis.reporting.report import report_json
from daq.clock import VirtualClock
from daq.errors import ConfigError, DeviceError
from daq.link.transport import memory_pair
from daq.live.viewfile import build_view
from daq.store.rowtimes import times
from daq.store.run import open_run
from rigs.recording.session import NO_CONTRACT, Recorded, Recording, record
from rigs.recording.stream import ColumnStream
from rigs.rigfile.columns import ColumnForm, load_columns
from rigs.rigfile.toml_reader import find_config
from rigs.virtual.emulators.columns import SLOW_PPM, VirtualColumns, join_columns
from rigs.virtual.emulators.injected_fault import INJECTED_FAULTS
from test_live_viewfile import contents

SKETCH = Path(__file__).resolve().parent.parent / "docs" / "examples" / "own-controller"


def form_of(folder: Path, *changes: tuple[str, str]) -> ColumnForm:
    text = find_config("own-controller", "recorders")[0]
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    path = folder / "mine.toml"
    path.write_text(text)
    return load_columns(str(path))


class Bench:
    """A recording on the virtual clock; ``at(s, what)`` does something to the device meanwhile."""

    def __init__(self, form: ColumnForm, out: Path) -> None:
        self.clock = VirtualClock()
        self.host, end = memory_pair(self.clock, "recorder")
        self.device: VirtualColumns = join_columns(form, end, self.clock)
        self.recording = Recording(form, self.host, self.clock, out)

    def at(self, seconds: float, what: Callable[[], Any]) -> None:
        done: list[bool] = []

        def look() -> None:
            if not done and self.clock.now_ns() > seconds * 1e9:
                done.append(True)
                what()

        self.recording._loop.add(look)

    def run(self, seconds: float, levels: tuple[float, ...] = ()) -> tuple[Recorded, pd.DataFrame]:
        made = self.recording.run(seconds, levels)
        return made, pd.read_csv(made.folder / "derived" / "recording.csv")


def test_every_line_becomes_a_row_with_its_own_time(tmp_path: Path) -> None:
    bench = Bench(form_of(tmp_path), tmp_path / "runs")
    made, table = bench.run(20.0, (200.0, 400.0))
    assert (made.outcome, made.faults, made.vented) == ("clean", {}, True)
    assert abs(made.rows - 4000) < 30
    assert made.times.method == "own time"
    # Its millis() count whole milliseconds: the steps between rows are 10 ms on its clock.
    step = table["time_s"].diff().dropna()
    assert step.mean() == pytest.approx(0.01 * (1 + SLOW_PPM * 1e-6), rel=2e-5)
    assert step.std() < 3.0 * made.times.u_between_s
    assert made.times.drift_ppm == pytest.approx(-SLOW_PPM, abs=30.0)
    held = table[(table.time_s > 30.0) & (table.time_s < 38.0)]
    assert held.pressure_kpa.to_numpy() == pytest.approx(400.0, abs=0.1)
    ratio = held.force_n / held.pressure_kpa
    assert ratio.std() < 1e-4 * ratio.mean() + 1e-4
    run = open_run(made.folder)
    assert run.problems == []
    assert run.final is not None
    assert run.final["counters"]["recorder"]["rows"] == made.rows
    assert sum(len(c) for c in [made.folder.joinpath("wire", "recorder.bin").read_bytes()]) > 10_000


def test_no_contract_is_said_in_the_record_and_in_the_report(tmp_path: Path) -> None:
    made, _ = Bench(form_of(tmp_path), tmp_path / "runs").run(1.0)
    assert open_run(made.folder).manifest["safety"] == NO_CONTRACT
    assert NO_CONTRACT in (made.folder / "derived" / "recording.md").read_text()
    assert json.loads((made.folder / "derived" / "recording.json").read_text())["vented"] is None


def test_the_report_states_rate_gaps_and_uncertainty_of_time(tmp_path: Path) -> None:
    bench = Bench(form_of(tmp_path), tmp_path / "runs")
    bench.at(3.0, lambda: setattr(bench.device, "mute", True))
    bench.at(4.2, lambda: setattr(bench.device, "mute", False))
    made, _ = bench.run(3.0, (100.0, 300.0))
    derived = made.folder / "derived"
    before = {p.name: p.read_bytes() for p in derived.iterdir()}
    run = derive_all(made.folder)
    # All that the recording made is there again, from the record alone.
    assert set(before) == {"recording.csv", "recording.md", "recording.json"}
    assert {name: (derived / name).read_bytes() for name in before} == before
    found = report_json(run)["results"]
    assert found["time"]["rate_hz"] == pytest.approx(100.0, rel=1e-3)
    assert found["time"]["u_between_s"] == made.times.u_between_s
    (gap,) = found["gaps"]
    assert (gap["from_s"], gap["seconds"]) == (
        pytest.approx(3.0, abs=0.05),
        pytest.approx(1.2, abs=0.03),
    )
    assert [(c["channel"], c["unit"]) for c in found["channels"]] == [
        ("pressure", "kPa"), ("force", "N"),
    ]  # fmt: skip
    high = next(c for c in found["channels"] if c["channel"] == "pressure")["high"]
    assert high == pytest.approx(300.0, abs=0.5)
    html = (derived / "report.html").read_text()
    assert NO_CONTRACT in html
    assert "Set-point 0 at the end: sent." in html


def test_the_view_of_a_recording_has_no_empty_panel(tmp_path: Path) -> None:
    made, table = Bench(form_of(tmp_path), tmp_path / "runs").run(1.0, (100.0,))
    run = open_run(made.folder)
    layout = analysis_of("record").layout(run.manifest["parameters"])
    curves, _ = contents(build_view(run, tmp_path / "view.rrd", layout))
    assert [p.title for p in layout.panels if p.kind == "series"] == ["Pressure (kPa)", "Force (N)"]
    assert set(curves) == {c.path for p in layout.panels for c in p.channels}
    assert curves["force/recorded"][:, 1] == pytest.approx(table.force_n.to_numpy())
    assert curves["pressure/set_point_kpa"][:2, 1].tolist() == [100.0, 0.0]


def test_without_a_time_of_its_own_the_arrival_bounds_it(tmp_path: Path) -> None:
    form = form_of(tmp_path, ('["time", "pressure_kpa"', '["pressure_kpa"'))
    bench = Bench(form, tmp_path / "runs")
    made, table = bench.run(10.0)
    assert made.times.method == "arrival"
    printed = np.arange(1, made.rows + 60) * bench.device._period_ns * 1e-9
    host_s = open_run(made.folder).samples("columns")["host_ns"] * 1e-9
    # The true time of each line, within the bound that its row states.
    true_s = np.array([printed[printed <= t + 1e-9][-1] for t in host_s])
    early = host_s - table.earlier_by_s
    assert (early <= true_s).all()
    assert made.times.u_host_s == pytest.approx((0.016 + 0.016) / 12**0.5, rel=0.3)


@pytest.mark.parametrize("unit", ["us", "s"])
def test_other_units_and_delimiters(unit: str, tmp_path: Path) -> None:
    form = form_of(
        tmp_path, ('time_unit = "ms"', f'time_unit = "{unit}"'),
        ('delimiter = "comma"', 'delimiter = "space"'), ("checksum = true", "checksum = false"),
    )  # fmt: skip
    made, table = Bench(form, tmp_path / "runs").run(5.0, (100.0,))
    assert (made.outcome, made.faults) == ("clean", {})
    assert table.pressure_kpa.iloc[-50:].max() == pytest.approx(100.0, abs=0.1)


def test_micros_that_start_anew_after_71_minutes(tmp_path: Path) -> None:
    form = form_of(tmp_path, ('time_unit = "ms"', 'time_unit = "us"'))
    stream = ColumnStream(memory_pair(VirtualClock(), "x")[0], form)
    own = [stream._own_s(float(v)) for v in (4_294_960_000, 4_294_967_000, 6_704, 16_704)]
    assert own == pytest.approx([4294.96, 4294.967, 4294.974, 4294.984])
    assert not stream.restarted


@pytest.mark.parametrize("fault", INJECTED_FAULTS)
def test_a_fault_on_the_wire_is_no_row(fault: str, tmp_path: Path) -> None:
    bench = Bench(form_of(tmp_path), tmp_path / "runs")
    bench.device.wire.bunch_ns = 0
    for k in range(5):
        bench.at(1.0 + 0.5 * k, lambda: bench.device.wire.arrange(fault))
    made, table = bench.run(6.0, (300.0,))
    assert made.outcome == "clean"
    if fault not in ("drop", "late"):
        assert sum(made.faults.values()) >= 5
    late = table[(table.time_s > 1.5) & (table.time_s < 5.8)]
    assert late.pressure_kpa.to_numpy() == pytest.approx(300.0, abs=0.5)
    assert table.time_s.is_monotonic_increasing


@settings(max_examples=40, deadline=None)
@given(st.lists(st.binary(max_size=40), max_size=12))
def test_whatever_comes_only_whole_lines_become_rows(pieces: list[bytes]) -> None:
    host, end = memory_pair(VirtualClock(), "x")
    stream = ColumnStream(host, load_columns("own-controller"))
    for piece in pieces:
        end.write(piece)
        stream.poll()
    good = b"\n12,1.0,2.0*28\n"
    end.write(good)
    stream.poll()
    assert [row[3] for row in stream.rows][-1:] in ([(1.0, 2.0)], [])


@pytest.mark.parametrize(
    ("what", "words"),
    [("mute", "no whole line for 2 s"), ("restart", "restarted"), ("unplug", "recorder"),
     ("high", r"above limit_kpa = 640"), ("deaf", r"confirms 0 kPa")],
)  # fmt: skip
def test_a_fault_ends_it_and_sets_0(what: str, words: str, tmp_path: Path) -> None:
    bench = Bench(form_of(tmp_path), tmp_path / "runs")

    def happen() -> None:
        if what == "unplug":
            bench.host.unplug()
        elif what == "restart":
            bench.device.jump_ms = -3_000_000
        elif what == "high":
            bench.device.kpa = 700.0
        else:
            setattr(bench.device, what, True)

    bench.at(4.0, happen)
    made, table = bench.run(20.0, (300.0,))
    assert made.outcome == "faulted"
    assert re.search(words, made.reason)
    assert made.vented is (what not in ("unplug", "deaf"))
    if made.vented:
        assert bench.device.set_kpa == 0.0
    assert table.pressure_kpa.max() < 701.0
    assert table.time_s.is_monotonic_increasing
    assert open_run(made.folder).problems == []


def test_a_level_above_the_limit_is_refused_before_anything_is_sent(tmp_path: Path) -> None:
    bench = Bench(form_of(tmp_path), tmp_path / "runs")
    with pytest.raises(DeviceError, match=r"setpoint\.high_kpa: set-point 700 kPa"):
        bench.recording.run(1.0, (700.0,))
    assert bench.device.set_kpa == 0.0


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [('"force_n"]', '"force_kn"]', "columns.*force_kn"), ("rate_hz = 100 ", "rate = 100 ", "rate"),
     ('"P={value:.1f}"', '"P"', "is not a line with"), ("(?P<value>[0-9.]+)", "(x", "regular"),
     ('"pressure_kpa", "force_n"]', '"force_n"]', "setpoint.*pressure_kpa"),
     ("scale = 1.0", "scale = 0", "scale of 0"), ("low = -20.0", "low = 2000", "not above low")],
)  # fmt: skip
def test_a_description_that_cannot_work_names_the_key(
    old: str, new: str, words: str, tmp_path: Path
) -> None:
    with pytest.raises(ConfigError, match=words):
        form_of(tmp_path, (old, new))


def test_the_stated_uncertainty_of_own_times_holds() -> None:
    """Delays of an adapter, a busy computer and a clock that is off, over 30 draws."""
    outside = []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        true_s = np.arange(3000) * 0.01 + rng.uniform(0.0, 1e-3)
        slow = 1.0 + rng.uniform(-300e-6, 300e-6)
        own_s = np.floor(true_s / slow * 1000.0) / 1000.0 + 77.0
        ready = true_s + 0.002
        came = np.ceil(ready / 0.016) * 0.016 + rng.exponential(0.001, 3000)
        host_s = np.maximum.accumulate(came)
        waited = np.diff(host_s, prepend=host_s[0] - 0.016)
        found = times(host_s, waited, own_s, 1e-3, 0.002, 0.016)
        error = found.time_s - true_s
        between = np.std(error - error.mean()) * 2**0.5
        outside.append(between > 2.0 * found.u_between_s)
        assert abs(error.mean()) < 0.016
        assert found.drift_ppm == pytest.approx((1.0 / slow - 1.0) * 1e6, abs=60.0)
    assert sum(outside) <= 1


def test_the_sketch_prints_what_the_description_reads() -> None:
    """The sketch is not compiled here: its format strings are those of the description."""
    text = (SKETCH / "own_controller.ino").read_text()
    assert '"%lu,%s,%s"' in text
    assert '"# P=%s"' in text
    assert "sum ^= *c" in text
    assert '"*%02X"' in text
    assert "line[0] == 'P' && line[1] == '='" in text


@pytest.mark.realtime
@pytest.mark.skipif(os.name != "posix", reason="pseudo-terminals")
def test_in_real_time_over_a_port(tmp_path: Path) -> None:
    own, theirs = os.openpty()
    tty.setraw(theirs)
    os.set_blocking(own, False)
    form = form_of(tmp_path, ('port = "virtual"', f'port = "{os.ttyname(theirs)}"'))
    device = VirtualColumns(form, lambda data: os.write(own, data) and None)
    stop = threading.Event()
    begin_ns = time.monotonic_ns()

    def serve() -> None:
        while not stop.is_set():
            with contextlib.suppress(BlockingIOError):
                device.feed(os.read(own, 256))
            device.advance(time.monotonic_ns() - begin_ns)
            time.sleep(0.001)

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        made = record(form, tmp_path / "runs", 1.5, (200.0,))
    finally:
        stop.set()
        thread.join()
        os.close(own)
        os.close(theirs)
    assert (made.outcome, made.vented) == ("clean", True)
    assert made.faults == {}
    assert made.rows > 50
    table = pd.read_csv(made.folder / "derived" / "recording.csv")
    assert table.pressure_kpa.max() == pytest.approx(200.0, abs=1.0)
