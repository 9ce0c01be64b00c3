"""Gauge blocks before the camera and between the holders, on the virtual bench and in its loop."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import cli.investigate.investigate as loop
from blind.live import Secret
from blind.physics.entries import Hidden
from blind.physics.readings import read_length
from cli.investigate.investigate import investigate
from cli.main import app
from daq.calibration import StandardReading
from daq.clock import VirtualClock
from daq.interrupt import StopFlag, Stopped
from daq.store.run import open_run
from daq.store.verify import findings
from gap.verdict import Status
from rigs.calibration.standards import _places, read_standards, readable_standards
from rigs.devices.operator import Request
from rigs.execution.runner import Watch
from rigs.rigfile.config import RigConfig, load_rig
from rigs.virtual.bench import VirtualBench
from rigs.virtual.withheld.bench import WithheldBench
from tests.test_investigate import few, rig_with
from tests.test_withheld import hiding, stated

BOTH = ("length_mm", "held_length_mm")


def errors(read: tuple[StandardReading, ...], channel: str) -> np.ndarray:
    return np.array([one.read - one.true for one in read if one.channel == channel])


def test_a_camera_and_holders_that_are_off_read_blocks_so(tmp_path: Path) -> None:
    config = rig_with(
        tmp_path, "[effects.camera_scale]\npercent = 0.5\n[effects.length_label]\noffset_mm = 0.3\n"
    )
    read, folder = read_standards(config, BOTH, tmp_path / "runs")
    true = np.array([one.true for one in read if one.channel == "length_mm"])
    assert len(set(true)) == 5
    assert np.ptp(true) > 15.0
    # The camera's own calibration is off by up to 0.02 mm and 0.05 % (k = 1) on this bench.
    assert errors(read, "length_mm") == pytest.approx(0.005 * true, abs=0.15)
    assert errors(read, "held_length_mm") == pytest.approx(-0.3, abs=0.06)
    assert all(0.0 < one.u < 0.05 for one in read)
    run = open_run(folder)
    assert (run.final or {})["outcome"] == "clean"
    assert findings(run) == ()
    assert len([e for e in run.events if e["kind"] == "standard_reading"]) == len(read)


def test_a_bench_of_hidden_physics_shows_blocks_by_its_own_camera(tmp_path: Path) -> None:
    bench, _ = hiding("camera_scale", 0.5)
    read, _ = read_standards(bench.config, ("length_mm",), tmp_path, bench=bench)
    true = np.array([one.true for one in read])
    expected = read_length(true, bench.live.constants, bench.live.effects) - true
    assert np.abs(expected).max() > 0.2
    assert errors(read, "length_mm") == pytest.approx(expected, abs=0.02)
    # The muscle is back: a camera that still saw the last block would say 70 mm.
    assert bench.sensor_error.length_mm(0.0) == bench.live.step(1e-6).length_mm


def test_a_gauge_beside_the_sensor_shows_what_the_sensor_is_off_by(tmp_path: Path) -> None:
    config = rig_with(tmp_path, "[effects.pressure_gain]\npercent = 3.0\n")
    read, folder = read_standards(config, ("pressure_kpa",), tmp_path / "runs")
    true = np.array([one.true for one in read])
    assert len(true) == 9  # up and down
    assert np.ptp(true) > 0.6 * config.limits.pressure_kpa
    # The sensor's own calibration is off by up to 0.5 kPa and 0.3 % (k = 1) on this bench.
    assert errors(read, "pressure_kpa") == pytest.approx(0.03 * true, abs=2.5)
    assert all(0.3 <= one.u < 0.5 for one in read)
    run = open_run(folder)
    assert len([e for e in run.events if e["kind"] == "standard_reading"]) == len(read)
    assert (run.final or {})["outcome"] == "clean"
    assert findings(run) == ()


def test_a_bench_of_hidden_physics_shows_its_gauge_by_its_own_sensor(tmp_path: Path) -> None:
    config = load_rig("virtual-instruments")
    secret = Secret((Hidden("pressure_gain", 1, 6.0),), stated(config), {})
    bench = WithheldBench(config, secret, VirtualClock())
    read, _ = read_standards(config, ("pressure_kpa",), tmp_path, bench=bench)
    true = np.array([one.true for one in read])
    # 0.9 of it is straight, the rest grows with the pressure.
    expected = true * 0.06 * (0.9 + 0.1 * true / 300.0)
    assert errors(read, "pressure_kpa") == pytest.approx(expected, abs=1.0)


def listened(bench: VirtualBench, heard: Callable[[Request], None]) -> None:
    """Have `heard` called with whatever the person at a virtual bench is asked."""
    make = bench.extras.operator

    def person(*args: object) -> object:
        found = make(*args)  # type: ignore[arg-type]
        assert found is not None
        begin = found.begin

        def told(request: Request) -> None:
            heard(request)
            begin(request)

        found.begin = told  # type: ignore[method-assign]
        return found

    bench.extras.operator = person  # type: ignore[method-assign, assignment]


def test_a_gauge_is_put_on_and_taken_off_a_vented_line(tmp_path: Path) -> None:
    config = load_rig("virtual")
    bench = VirtualBench(config, VirtualClock())
    at: list[tuple[str, float]] = []
    listened(bench, lambda request: at.append((request.axis, bench.plant.pressure_kpa)))
    read_standards(config, ("pressure_kpa",), tmp_path, bench=bench)
    assert [axis for axis, _ in at] == ["gauge", *(["reference pressure"] * 9), "gauge"]
    assert all(abs(kpa) < 2.0 for axis, kpa in at if axis == "gauge")
    assert all(kpa > 50.0 for axis, kpa in at if axis != "gauge")


def test_the_stage_moves_only_when_nothing_is_between_the_holders(tmp_path: Path) -> None:
    """A block of 70 mm was still in when it went to 53."""
    asked: list[str] = []
    moved: list[str] = []
    config = load_rig("virtual")
    bench = VirtualBench(config, VirtualClock())
    step = bench.plant.set_length_rate

    def rate(mm_s: float) -> None:
        moved.append(asked[-1] if asked else "")
        step(mm_s)

    bench.plant.set_length_rate = rate  # type: ignore[method-assign]
    listened(bench, lambda request: asked.append(request.axis))
    read_standards(config, BOTH, tmp_path, bench=bench)
    assert moved
    assert set(moved) == {"clear"}


@pytest.mark.parametrize(("low", "high"), [(51.0, 72.5), (5.0, 70.0), (0.2, 4.0)])
def test_lengths_of_blocks_differ_and_lie_within_the_range(low: float, high: float) -> None:
    for count in (3, 5):
        places = _places(low, high, count)
        assert len(set(places)) == count
        assert all(low <= place <= high for place in places)


def test_what_nobody_can_set_is_not_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    assert readable_standards(load_rig("virtual")) == ("pressure_kpa", *BOTH)
    by_hand = load_rig("virtual-weights")
    assert by_hand.stage.kind == "manual"
    assert "held_length_mm" not in readable_standards(by_hand)  # no scale is written down there
    monkeypatch.setattr(RigConfig, "is_virtual", False)
    assert readable_standards(load_rig("virtual")) == ()  # no terminal: nobody is there


def test_a_stop_keeps_the_record_and_what_was_read(tmp_path: Path) -> None:
    stop = StopFlag()
    watch = Watch()
    asked: list[str] = []

    def state(text: str) -> None:
        asked.append(text)
        if len(asked) == 3:
            stop.set("test")

    watch.state = state  # type: ignore[method-assign]
    with pytest.raises(Stopped):
        read_standards(load_rig("virtual"), BOTH, tmp_path, stop=stop, watch=watch)
    (folder,) = [path for path in tmp_path.iterdir() if path.is_dir()]
    run = open_run(folder)
    assert (run.final or {})["outcome"] == "stopped"
    assert len([e for e in run.events if e["kind"] == "standard_reading"]) == 2


def test_the_command_writes_what_a_data_set_takes(tmp_path: Path) -> None:
    out = tmp_path / "standards.csv"
    wanted = ["calibrate", "check", "--out", str(out), "--records", str(tmp_path), "--json"]
    done = CliRunner().invoke(app, wanted)
    assert done.exit_code == 0, done.output
    told = json.loads(done.stdout)
    rows = out.read_text().splitlines()
    assert rows[0] == "channel,true,read,u"
    assert len(rows) == 1 + len(told["readings"]) == 9
    again = CliRunner().invoke(app, wanted)
    assert again.exit_code != 0
    assert "exists already" in str(again.exception or again.output)


@pytest.mark.parametrize(
    ("extra", "named"),
    [
        (["--channels", "force_n"], "'force_n' cannot be read with a standard"),
        (["--channels", ""], "--channels"),
        (["--u-mm", "0"], "--u-mm"),
        (["--channels", "pressure_kpa", "--u-kpa", "0"], "--u-kpa"),
        (
            ["--rig", "virtual-weights", "--channels", "held_length_mm"],
            "possible: pressure_kpa, length_mm",
        ),
    ],
)
def test_what_cannot_be_checked_is_refused_before_anything_moves(
    extra: list[str], named: str, tmp_path: Path
) -> None:
    out = tmp_path / "standards.csv"
    done = CliRunner().invoke(app, ["calibrate", "check", "--out", str(out), *extra])
    assert done.exit_code != 0
    assert named in str(done.exception or "") + done.output
    assert not out.exists()


def test_where_no_test_decides_a_standard_is_read_and_names_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A wrong label looks like a camera that is off, as on withheld benches 853, 854 and 859."""
    monkeypatch.setattr(loop, "battery", few)
    config = rig_with(tmp_path, "[effects.length_label]\noffset_mm = 0.4\n")
    bench = VirtualBench(config, VirtualClock())
    found = investigate(config, tmp_path / "runs", bench=bench, derive=False)
    assert (found.conclusion, found.family) == ("named", "length_sensor")
    assert found.verdict.status is Status.NAMED
    assert found.verdict.effects[0].ids == ("length_label",)
    assert found.references == {}
    last = found.rounds[-1]
    assert last.protocol == "reference standards"
    assert "length_label" in last.why
    assert list(found.folder.glob("data-*/standards.csv"))
