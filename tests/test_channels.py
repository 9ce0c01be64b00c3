"""Force and length on the controller's own inputs: tests, faults, files and calibration."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from analysis.regression.calibration_line import Reference
from analysis.run_table import reduce_run
from bench_process import bench_process, run_pamrig
from bench_runs import quick, run_isometric
from daq.errors import ConfigError, DeviceError, DeviceTimeout
from daq.store.derive import engineering
from daq.store.run import Run, open_run
from daq.store.verify import verify
from protocol_runs import run_short
from rigs.bench.doctor import examine
from rigs.bench.rig import open_rig
from rigs.calibration.force import calibrate_force
from rigs.execution.runner import Runner, Watch
from rigs.execution.session import Result
from rigs.rigfile.calibration_file import write_calibration
from rigs.rigfile.config import RigConfig, load_rig
from rigs.virtual.bench import VirtualBench
from rigs.virtual.board.inputs import VirtualBridge

RIG = "virtual-channels"


def rig_with(folder: Path, *changes: tuple[str, str]) -> RigConfig:
    text = load_rig(RIG).text
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new, 1)
    path = folder / "rig.toml"
    path.write_text(text)
    return load_rig(str(path))


Begin = Callable[[Runner, VirtualBench], None]


def run_with(
    folder: Path, begin: Begin | None = None, config: RigConfig | None = None, **changes: Any
) -> tuple[Result, Run, VirtualBench]:
    kept: list[VirtualBench] = []

    def start(runner: Runner, record: object) -> None:
        del record
        assert runner.rig.bench is not None
        kept.append(runner.rig.bench)
        if begin is not None:
            begin(runner, runner.rig.bench)

    config = config or load_rig(RIG)
    shape = {"lengths_mm": (58.0, 64.0), "pressures_kpa": (200.0, 400.0), "order": "up-down"}
    plan = quick(config, **{**shape, **changes})
    result = run_isometric(config, plan, folder / "runs", derive=False, on_start=start)
    return result, open_run(result.folder), kept[0]


def part(bench: VirtualBench, name: str) -> Any:
    assert bench.extras.inputs is not None
    return bench.extras.inputs.parts[name]


TRUTH: list[tuple[int, float]] = []
"""Bench time in us, which is the device time of a board that never restarted, and true force."""


@pytest.fixture(scope="module")
def isometric(tmp_path_factory: pytest.TempPathFactory) -> tuple[Run, VirtualBench]:

    def begin(runner: Runner, bench: VirtualBench) -> None:
        TRUTH.clear()
        runner.rig.event_loop.add(lambda: TRUTH.append((bench.board.bench_us, bench.plant.force_n)))

    result, run, bench = run_with(tmp_path_factory.mktemp("isometric"), begin)
    assert result.outcome == "clean", result.error
    return run, bench


def test_points_have_force_and_length_of_the_controller(
    isometric: tuple[Run, VirtualBench],
) -> None:
    run, _ = isometric
    assert verify(run) == []
    assert run.manifest["force_source"] == "cell"
    assert run.manifest["length_source"] == "encoder"
    table = reduce_run(run).table
    assert len(table) >= 6
    assert (table["length_mm"] - table["set_length_mm"]).abs().max() < 0.06
    points = [e for e in run.events if e["kind"] == "point"]
    valve = run.samples("valve")
    for row, point in zip(table.to_dict("records"), points, strict=True):
        first, end = point["valve_seq"]
        inside = (valve["seq"] >= first) & (valve["seq"] < end)
        from_us, to_us = valve["device_us"][inside][[0, -1]]
        true_n = np.mean([n for us, n in TRUTH if from_us <= us <= to_us])
        assert row["force_n"] == pytest.approx(true_n, abs=3.0 * row["u_force_n"])


def test_readings_have_the_device_time_of_the_pressure(
    isometric: tuple[Run, VirtualBench],
) -> None:
    run, _ = isometric
    valve = run.samples("valve")
    for name, period_us in (("cell", 12_500 * 1.012), ("encoder", 20_000), ("gauge", 100_000)):
        rows = run.samples(name)
        steps = np.diff(rows["device_us"])
        assert steps.mean() == pytest.approx(period_us, rel=0.01)
        assert (steps > 0).all()
        assert set(rows["boot"]) == set(valve["boot"])
        inside = rows["device_us"][rows["device_us"] >= valve["device_us"][0]]
        assert np.isin(inside, valve["device_us"]).all()  # each was read at a sample's time
    cell, force = engineering(run, "cell")[0], engineering(run, "balance")[0]
    assert np.allclose(cell["time_s"], force["time_s"])


def test_pressure_and_force_of_one_instant_belong_together(
    isometric: tuple[Run, VirtualBench],
) -> None:
    """The second transducer at the muscle follows the first one within a few ms in a filling."""
    run, _ = isometric
    gauge, valve = engineering(run, "gauge")[0], engineering(run, "valve")[0]
    at = np.interp(gauge["time_s"], valve["time_s"], valve["pressure_kpa"])
    rate = np.abs(np.gradient(at, gauge["time_s"]))
    moving = rate > 400.0  # noise and calibration of both leave 2 kPa
    assert moving.sum() > 5
    late_s = np.abs(gauge["pressure_kpa"] - at - np.median((gauge["pressure_kpa"] - at)[~moving]))
    assert (late_s[moving] / rate[moving]).max() < 0.005


def test_hysteresis_runs_on_the_same_rig(tmp_path: Path) -> None:
    result, run, _ = run_short("hysteresis", tmp_path, RIG)
    assert result.outcome == "clean", result.error
    assert verify(run) == []
    assert reduce_run(run).table["force_n"].max() > 10.0


# ---- faults ---------------------------------------------------------------------------


def check_no_wrong_value(run: Run, bench: VirtualBench, name: str, most: float) -> None:
    """Every reading that was kept is near the readings on both of its sides."""
    reading = run.samples(name)["reading"]
    middle = np.median(np.lib.stride_tricks.sliding_window_view(reading, 9), axis=1)
    assert np.abs(reading[4:-4] - middle).max() < most, name


@pytest.mark.parametrize("source", ["cell", "encoder"])
def test_a_source_that_falls_silent_ends_the_run_and_leaves_no_wrong_value(
    tmp_path: Path, source: str
) -> None:
    def pull(made: Any) -> None:
        made.gone = True

    chip = ('chip = "encoder"', 'chip = "ads1115"') if source == "encoder" else ("", "")
    scale = ("scale = 0.005 ", "scale = 0.002 ") if source == "encoder" else ("", "")
    config = rig_with(tmp_path, chip, scale)
    result, run, bench = run_with(tmp_path, during(source, pull, 4.0, 1e9), config)
    assert result.outcome == "faulted"
    assert source in str(result.error)
    assert "silent" in run.final["counters"][source]  # type: ignore[index]
    assert any(e["kind"] == "instrument" and e["device"] == source for e in run.events)
    check_no_wrong_value(run, bench, source, 2000.0)
    assert bench.board.pressure_kpa < 5.0


def during(name: str, change: Callable[[Any], None], begin_s: float, end_s: float) -> Begin:
    """Change a part for a while, in the middle of a run."""

    def begin(runner: Runner, bench: VirtualBench) -> None:
        made = part(bench, name)
        start = bench.time_s
        state = {"on": False}

        def look() -> None:
            on = begin_s <= bench.time_s - start < end_s
            if on != state["on"]:
                state["on"] = on
                change(made)

        runner.rig.event_loop.add(look)

    return begin


def test_a_plug_pulled_for_a_moment_is_counted_and_the_run_goes_on(tmp_path: Path) -> None:
    def pull(made: Any) -> None:
        made.gone = not made.gone

    result, run, bench = run_with(tmp_path, during("cell", pull, 3.0, 3.4))
    assert result.outcome == "clean", result.error
    counts = run.final["counters"]["cell"]  # type: ignore[index]
    assert counts["silent"] >= 1
    check_no_wrong_value(run, bench, "cell", 40_000.0)
    assert np.diff(run.samples("cell")["device_us"]).max() > 400_000


def test_a_saturated_converter_is_counted_and_gives_no_value(tmp_path: Path) -> None:
    def pull(made: Any) -> None:
        made.pull = 2e7 - made.pull

    result, run, _ = run_with(tmp_path, during("cell", pull, 3.0, 3.4))
    assert result.outcome == "clean", result.error
    counts = run.final["counters"]["cell"]  # type: ignore[index]
    assert counts["overload"] >= 20
    assert run.samples("cell")["reading"].max() < 2**23 - 1


def test_a_stuck_converter_ends_the_run(tmp_path: Path) -> None:
    def begin(runner: Runner, bench: VirtualBench) -> None:
        part(bench, "cell").stuck = True

    result, run, _ = run_with(tmp_path, begin)
    assert result.outcome == "faulted"
    assert "same reading again and again" in str(result.error)
    assert run.final["counters"]["cell"]["stuck"] > 10  # type: ignore[index]


def test_an_encoder_that_jumps_ends_the_run_before_a_wrong_length(tmp_path: Path) -> None:
    def jump(made: Any) -> None:
        made.glitch = True

    result, run, _ = run_with(tmp_path, during("encoder", jump, 8.0, 8.1))
    assert result.outcome == "faulted"
    assert "encoder" in str(result.error)
    assert run.final["counters"]["encoder"]["lost_count"] > 10  # type: ignore[index]
    points = reduce_run(run).table
    assert len(points) >= 1
    assert (points["length_mm"] - points["set_length_mm"]).abs().max() < 0.06


def test_an_encoder_that_counts_from_elsewhere_is_refused() -> None:
    """The controller restarted at another length than that of the zero."""
    config = load_rig(RIG)
    with open_rig(config) as rig:
        bench = rig.bench
        assert bench is not None
        assert rig.length_reader is not None
        rig.stage.set_value(58.0)
        assert rig.length_reader.next_mean(5) == pytest.approx(58.0, abs=0.06)
    bench.board.reset("power")
    words = r"reads 61\.7\d mm, and the stage stands at 58\.00 mm"
    with pytest.raises(DeviceError, match=words), open_rig(config, bench=bench):
        pass


def test_a_cell_is_calibrated_with_weights(tmp_path: Path) -> None:
    """The file of `pamrig calibrate force` is in counts, and a rig file takes it."""
    weights = Reference("weights E-1", u_gain=1e-4, u_each=0.0)
    done = calibrate_force(
        load_rig(RIG), [0.0, 1.0, 2.5, 5.0], tmp_path, weights=weights, seconds=1.0
    )
    made = done.file.calibration
    assert made.raw_unit == "count"
    assert done.file.instrument == "LC-0009"
    assert made.scale == pytest.approx(8.3e-5, rel=2e-3)
    write_calibration(tmp_path / "cell.toml", done.file, done.points)
    lines = load_rig(RIG).text.partition('serial = "LC-0009"\n')[2].partition("\n\n")[0]
    config = rig_with(tmp_path, (lines, 'calibration = "cell.toml"'))
    assert config.calibrations["force_n"].id == made.id
    assert config.calibrations["force_n"].raw_unit == "g"


@pytest.mark.parametrize("noise", [0.0, 2000.0])
def test_a_weight_at_the_end_of_the_converter_is_left_out_of_the_calibration(
    noise: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With noise some of its readings are within the range: their mean was 0.2 N too low."""
    rng, said = np.random.default_rng(3), list[str]()
    bridge, at_5_kg = VirtualBridge.read, round(5.0 * 9.80665 / 8.3e-5)

    def read(self: VirtualBridge, now_us: int) -> int:
        beyond = float(rng.normal(0.0, noise)) if noise else 20_000.0
        self.pull = 2**23 - at_5_kg + beyond
        return bridge(self, now_us)

    monkeypatch.setattr(VirtualBridge, "read", read)
    done = calibrate_force(
        load_rig(RIG), [0.0, 1.0, 2.5, 5.0], tmp_path, weights=Reference("E-1", u_gain=1e-4),
        seconds=1.0, watch=Watch(log=said.append),
    )  # fmt: skip
    assert sorted({reference for _, reference, _ in done.points}) == pytest.approx(
        [0.0, 9.80665, 2.5 * 9.80665]
    )
    assert said == [
        "calibrate force, 5 kg: left out, cell (hx711 at the valve controller on valve)"
        " is at the end of its range"
    ]
    events = open_run(done.folder).events
    assert [e["mass_kg"] for e in events if e["kind"] == "left_out"] == [5.0]


# ---- rig files ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "expect"),
    [
        ((('chip = "hx711"', 'chip = "hx712"'),), "channels.cell.chip"),
        ((("rate_hz = 80 ", "rate_hz = 40 "),), "channels.cell.rate_hz: 40 is not 10 or 80"),
        ((("gain = 128", "gain = 100"),), "channels.cell.gain: 100 is not one of 32, 64, 128"),
        ((("rate_hz = 50\n", "rate_hz = 100\n"), ("rate_hz = 10\n", "rate_hz = 100\n")),
         "280 readings a second together"),
        ((('chip = "encoder"', 'chip = "ads1232"'), ("rate_hz = 50\n", "rate_hz = 10\n")),
         "has the same pins of the controller as [channels.cell]"),
        ((('force_source = "cell"', 'force_source = "gauge"'),), "'gauge' is not one of"),
        ((('length_source = "encoder"', 'length_source = "cell"'),), "'cell' reads no length"),
        ((("scale = 8.3e-5 ", "scale = 0.0 "),), "a scale of 0"),
        ((("[channels.cell]", "[channels.balance]"), ), "channels.balance"),
        ((("gain = 128", "gian = 128"),), "gian"),
        ((('input = "second"', 'input = "fourth"'),), "channels.gauge.input"),
    ],
)  # fmt: skip
def test_bad_rig_files_name_the_key(
    tmp_path: Path, changes: tuple[tuple[str, str], ...], expect: str
) -> None:
    with pytest.raises(ConfigError) as caught:
        rig_with(tmp_path, *changes)
    assert expect in str(caught.value)
    assert "\n" not in str(caught.value)


def test_doctor_looks_at_every_channel(tmp_path: Path) -> None:
    found = {f.what: f for f in examine(RIG, tmp_path)}
    for name in ("cell", "encoder", "gauge"):
        assert found[f"{name} readings"].status == "ok", found[f"{name} readings"].detail
    assert "hx711" in found["cell"].detail


def test_a_channel_without_a_converter_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    made = VirtualBench.__init__

    def gone(self: VirtualBench, *args: Any, **options: Any) -> None:
        made(self, *args, **options)
        part(self, "cell").gone = True

    monkeypatch.setattr(VirtualBench, "__init__", gone)
    words = r"cell \(hx711 .*no reading within .*stopped sending"
    with pytest.raises(DeviceTimeout, match=words), open_rig(load_rig(RIG)):
        pass


@pytest.mark.parametrize(
    ("chip", "more", "rate_hz"),
    [
        ("ads1232", 'gain = 64', 80.0),
        ("hx711", "gain = 32", 10.0),
        ("ads1115", 'input = "2-3"\nrange_v = 0.256', 100.0),
        ("analogue", 'input = "third"', 50.0),
    ],
)  # fmt: skip
def test_every_converter_reads_the_force(
    tmp_path: Path, chip: str, more: str, rate_hz: float
) -> None:
    scale = {"ads1115": 0.01, "analogue": 0.1}.get(chip, 8.3e-5)
    config = rig_with(
        tmp_path,
        ('chip = "hx711"', f'chip = "{chip}"'),
        ("gain = 128", more),
        ("rate_hz = 80 ", f"rate_hz = {rate_hz:g} "),
        ("scale = 8.3e-5 ", f"scale = {scale} "),
        ("offset = 0.0\nlow = -20", "offset = -5.0\nlow = -20"),
    )
    with open_rig(config) as rig:
        cell = rig.instruments["cell"]
        before = cell.rows
        rig.event_loop.for_seconds(5.0)
        assert cell.rows - before == pytest.approx(5.0 * rate_hz, rel=0.12)
        assert cell.faults.counts == {}
        assert cell.mean(20) == pytest.approx(0.0, abs=0.5)


def test_a_run_of_two_controllers_takes_the_channels_of_the_first() -> None:
    joint = load_rig("virtual-joint")
    channels = load_rig(RIG).instruments.channels
    both = dataclasses.replace(
        joint, instruments=dataclasses.replace(joint.instruments, channels=channels)
    )
    assert both.side_b is not None
    assert both.side_b.instruments.channels == {}


@pytest.mark.realtime
def test_isometric_and_hysteresis_in_real_time_over_ports(tmp_path: Path) -> None:
    with bench_process(tmp_path / "bench", RIG) as bench:
        for protocol in ("isometric", "hysteresis"):
            done = run_pamrig(
                protocol, "--rig", bench.rig, "--protocol", f"{protocol}-short",
                "--out", tmp_path / "runs",
            )  # fmt: skip
            assert done.returncode == 0, done.stderr
    for folder in sorted((tmp_path / "runs").glob("2*")):
        run = open_run(folder)
        assert run.outcome == "clean"
        assert verify(run) == []
        counters = run.final["counters"]  # type: ignore[index]
        assert counters["valve"]["channel_missing"] == 0
        for name in ("cell", "encoder", "gauge"):
            assert set(counters[name]) == {"rows"}
        assert np.diff(run.samples("cell")["device_us"]).max() < 60_000
