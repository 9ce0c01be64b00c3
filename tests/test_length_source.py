"""An instrument in place of the camera is the source of the length: over Modbus and in lines."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from analysis.layouts.layouts import LENGTH
from analysis.reporting.report import report_json
from analysis.run_table import reduce_run
from bench_runs import quick, run_isometric
from daq.errors import ConfigError
from daq.live.viewfile import _fill
from daq.store.run import Run, open_run
from daq.store.verify import verify
from gap.data.run_trials import run_trials
from protocol_runs import run_short
from rigs.bench.doctor import examine
from rigs.execution.runner import Runner
from rigs.execution.session import Result, run_protocol
from rigs.live.feed import LiveFeed
from rigs.protocols.registry import procedure
from rigs.rigfile.config import RigConfig, load_rig
from rigs.virtual.bench import VirtualBench

RIG = "virtual-laser"
TEXT = (
    ('protocol = "modbus"         # RTU; without this key the instrument speaks in lines\n', ""),
    ('baud = 115200\nserial = "LAS', 'baud = 9600\nform = "gauge-text"\nserial = "LAS'),
    *((f"{key}\n", "") for key in (
        "device_id = 1",
        "register = 0                # this and the next keys are in the manual of the sensor",
        'function = "input"', 'kind = "int32"', 'word_order = "ABCD"',
        "scale = 0.001               # mm for each step",
        "overload = 2147483647       # what it sends when it sees nothing",
        'quantity = "length_mm"', 'unit = "mm"',
        "low = 5.0                   # measuring range, mm", "high = 45.0",
    )),
)  # fmt: skip
"""The same rig with a gauge that answers in lines."""


def rig_with(tmp_path: Path, *changes: tuple[str, str]) -> RigConfig:
    text = load_rig(RIG).text
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    path = tmp_path / "rig.toml"
    path.write_text(text)
    return load_rig(str(path))


Begin = Callable[[Runner, VirtualBench], None]


def run_with(
    tmp_path: Path, begin: Begin | None = None, config: RigConfig | None = None, **changes: Any
) -> tuple[Result, Run, VirtualBench]:
    kept: list[VirtualBench] = []

    def start(runner: Runner, record: object) -> None:
        del record
        assert runner.rig.bench is not None
        kept.append(runner.rig.bench)
        if begin is not None:
            begin(runner, runner.rig.bench)

    config = config or load_rig(RIG)
    shape = {"lengths_mm": (57.0, 66.0), "pressures_kpa": (200.0, 500.0), "order": "up-down"}
    plan = quick(config, **{**shape, **changes})
    result = run_isometric(config, plan, tmp_path / "runs", derive=False, on_start=start)
    return result, open_run(result.folder), kept[0]


@pytest.mark.parametrize("changes", [(), TEXT])
def test_points_have_the_length_of_the_instrument(
    tmp_path: Path, changes: tuple[tuple[str, str], ...]
) -> None:
    result, run, _ = run_with(tmp_path, config=rig_with(tmp_path, *changes), zero_s=0.3)
    assert result.outcome == "clean", result.error
    assert verify(run) == []
    assert run.manifest["length_source"] == "laser"
    assert not run.frames
    table = reduce_run(run).table
    stream, own = run.samples("laser"), run.calibration("length_mm")
    points = [e for e in run.events if e["kind"] == "point"]
    assert len(points) == len(table) >= 6
    for row, event in zip(table.to_dict("records"), points, strict=True):
        first, end = event["length_rows"]
        assert end - first >= 4
        inside = (stream["row"] >= first) & (stream["row"] < end)
        mean = float(own.apply(stream["reading"][inside]).mean())
        assert row["length_mm"] == pytest.approx(mean, abs=1e-9)
        assert abs(row["length_mm"] - row["set_length_mm"]) < 3.0 * row["u_length_mm"] < 0.15
        assert row["u_length_mm"] == pytest.approx(
            np.hypot(row["u_length_mm_noise"], row["u_length_mm_cal"])
        )
    assert "laser" in json.dumps(report_json(run, reduce_run(run)))


def test_a_trial_of_the_diagnosis_has_the_readings(tmp_path: Path) -> None:
    _, run, _ = run_with(tmp_path, lengths_mm=(60.0,))
    trials = list(run_trials(run))
    assert trials
    for trial in trials:
        lengths = trial.samples["length_mm"].dropna()
        assert len(lengths) > 20
        assert np.median(lengths) == pytest.approx(60.0, abs=0.2)


@pytest.mark.parametrize("protocol", ["isobaric", "hysteresis", "isotonic"])
def test_other_static_tests_run_without_a_camera(tmp_path: Path, protocol: str) -> None:
    result, run, _ = run_short(protocol, tmp_path, RIG)
    assert result.outcome == "clean", result.error
    table = reduce_run(run).table
    assert len(table)
    assert table["length_mm"].notna().all()
    assert (table["u_length_mm"] > 0.0).all()


@pytest.mark.parametrize("what", ["mute", "unplug", "half line"])
def test_a_lost_laser_ends_the_run_vented(tmp_path: Path, what: str) -> None:
    """At the first point it falls silent, loses its cable, or sends halves of its answers."""

    def begin(runner: Runner, bench: VirtualBench) -> None:
        laser: Any = bench.extras.devices["laser"]

        def point(*_: Any) -> None:
            if what == "unplug":
                bench.unplug("laser")
            elif what == "mute":
                laser.mute = True
            else:
                send = laser.wire.send
                laser.wire.send = lambda data, at_ns: send(data[: len(data) // 2], at_ns)

        runner.watch.point = point

    result, run, _ = run_with(tmp_path, begin)
    assert result.outcome == "faulted"
    assert "laser" in str(result.error)
    (vented,) = (e for e in run.events if e["kind"] == "vented")
    assert vented["confirmed"]
    assert len([e for e in run.events if e["kind"] == "point"]) == 1
    assert verify(run) == []


def test_overload_is_counted_and_no_value(tmp_path: Path) -> None:
    def begin(runner: Runner, bench: VirtualBench) -> None:
        del runner
        laser: Any = bench.extras.devices["laser"]
        send, count = laser.registers, [0]

        def registers() -> dict[int, int]:
            count[0] += 1
            laser.flag = "overload" if count[0] % 10 == 0 else ""
            return dict(send())

        laser.registers = registers

    result, run, _ = run_with(tmp_path, begin, lengths_mm=(60.0,))
    assert result.outcome == "clean", result.error
    assert run.final is not None
    assert run.final["counters"]["laser"]["overload"] > 5
    readings = run.samples("laser")["reading"]
    assert np.all((readings > 5.0) & (readings < 45.0))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (('length_source = "laser" ', 'length_source = "lasr" '), "is no instrument of this rig"),
        (('length_source = "laser" ', "# "), "camera"),
        (('unit = "mm"\nrate', 'unit = "kg"\nrate'), "is not a unit of length"),
        (("direction = -1", "direction = 0"), "direction"),
        (("[instruments.laser]", '[camera]\nsource = "virtual"\n[instruments.laser]'), "camera"),
        (
            ('quantity = "length_mm"', 'quantity = "humidity_percent"'),
            "reads no length|unknown key",
        ),
    ],
)
def test_a_wrong_rig_file_is_one_line(tmp_path: Path, change: tuple[str, str], words: str) -> None:
    with pytest.raises(ConfigError, match=words) as caught:
        rig_with(tmp_path, change)
    assert "\n" not in str(caught.value)


def test_the_doctor_needs_no_camera(tmp_path: Path) -> None:
    findings = examine(RIG, tmp_path)
    assert not [f for f in findings if f.status == "stop"]
    assert not [f for f in findings if "camera" in f.what]
    assert [f for f in findings if f.what == "laser"]


class Sink:
    """Takes what a view is given, by path."""

    error = None

    def __init__(self) -> None:
        self.got: dict[str, list[float]] = {}
        self.places: dict[str, list[tuple[float, float]]] = {}

    def series(self, path: str, times: Any, values: Any) -> None:
        self.got.setdefault(path, []).extend(float(v) for v in values)

    def __getattr__(self, name: str) -> Callable[..., None]:
        def points(path: str, *words: Any, **more: Any) -> None:
            del more
            x, y = [np.ravel(w)[0] for w in words if not isinstance(w, str)][-2:]
            self.places.setdefault(path, []).append((float(x), float(y)))

        return points if name == "points" else lambda *words, **more: None


def test_live_view_and_its_file_show_the_length_of_the_instrument(tmp_path: Path) -> None:
    config = load_rig(RIG)
    plan = quick(config, lengths_mm=(60.0,), pressures_kpa=(200.0, 500.0), order="up-down")
    kind = procedure("isobaric")
    layout = kind.analysis.layout(plan.as_dict())
    live = Sink()
    result = run_protocol(
        procedure("isometric"), config, plan, tmp_path,
        make_live=lambda run_id: LiveFeed(live, layout),  # type: ignore[arg-type]
    )  # fmt: skip
    assert result.outcome == "clean", result.error
    stored, run = Sink(), open_run(result.folder)
    _fill(stored, run, layout, None, 1000)  # type: ignore[arg-type]
    for sink in (live, stored):
        assert len(sink.got[LENGTH]) > 50
        assert np.median(sink.got[LENGTH]) == pytest.approx(60.0, abs=0.1)
        (points,) = [p for path, p in sink.places.items() if "points" in path]
        assert len(points) >= 2
        assert all(abs(x - 60.0) < 0.1 for x, _ in points)
