"""A transducer with a port of its own is the pressure of a test; the controller's must agree."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from analysis.reporting.report import report_json
from analysis.run_table import reduce_run
from bench_runs import quick, run_isometric
from daq.errors import ConfigError
from daq.store.run import Run, open_run
from daq.store.verify import verify
from gap.data.run_trials import run_trials
from protocol_runs import run_short
from rigs.execution.runner import Runner
from rigs.execution.session import Result
from rigs.rigfile.config import RigConfig, load_rig
from rigs.virtual.bench import VirtualBench

RIG = "virtual-transducer"
SENSOR = "pressure_transmitter"
Begin = Callable[[Runner, VirtualBench], None]


def rig_with(tmp_path: Path, *changes: tuple[str, str]) -> RigConfig:
    text = load_rig(RIG).text
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = tmp_path / "rig.toml"
    path.write_text(text)
    return load_rig(str(path))


def run_with(
    tmp_path: Path, begin: Begin | None = None, config: RigConfig | None = None, **changes: Any
) -> tuple[Result, Run]:
    def start(runner: Runner, record: object) -> None:
        del record
        assert runner.rig.bench is not None
        if begin is not None:
            begin(runner, runner.rig.bench)

    config = config or load_rig(RIG)
    shape = {"lengths_mm": (60.0,), "pressures_kpa": (200.0, 500.0), "order": "up-down"}
    plan = quick(config, **{**shape, **changes})
    result = run_isometric(config, plan, tmp_path / "runs", derive=False, on_start=start)
    return result, open_run(result.folder)


def transducer(bench: VirtualBench) -> Any:
    return bench.extras.devices[SENSOR]


def distorted(change: Callable[[float, float], float]) -> Begin:
    """What the transducer sends is changed: of its reading in kPa and the bench's time in s."""

    def begin(runner: Runner, bench: VirtualBench) -> None:
        device = transducer(bench)
        read = device._read
        device._read = lambda: change(read(), bench.time_s)

    return begin


def check_faulted_and_vented(result: Result, run: Run) -> str:
    assert result.outcome == "faulted"
    assert verify(run) == []
    (vented,) = (e for e in run.events if e["kind"] == "vented")
    assert vented["confirmed"]
    return str(result.error)


def seconds_at(run: Run, kind: str) -> float:
    return float(next(e["t_ns"] for e in run.events if e["kind"] == kind)) * 1e-9


# ---- the rig file -----------------------------------------------------------------------


def test_the_default_band_is_what_both_calibrations_and_the_converter_allow() -> None:
    config = load_rig(RIG)
    controller, own = config.calibrations["pressure_kpa"], config.pressure_calibration
    assert own.id == "PT-2026-03"
    for kpa in (0.0, 600.0):
        u = float(np.hypot(controller.u(kpa), own.u(kpa)))
        assert config.sensor_band_kpa(kpa) == pytest.approx(3 * u + 2 * controller.scale)


def test_a_stated_band_is_taken(tmp_path: Path) -> None:
    config = rig_with(tmp_path, ("# sensor_band_kpa = 2.0 ", "sensor_band_kpa = 2.0 "))
    assert config.sensor_band_kpa(600.0) == 2.0


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (('sensor = "pressure_transmitter"', 'sensor = "gauge"'), "is no instrument of this rig"),
        (('kind = "solenoids"\n', 'kind = "solenoids"\nsensor_bnad_kpa = 1.0\n'), "unknown key"),
        (("sensor_lag_s = 0.5", "sensor_lag_s = 0.0"), "sensor_lag_s"),
        (('sensor = "pressure_transmitter"', "sensor = 5"), "sensor"),
    ],
)
def test_a_wrong_key_is_one_line(tmp_path: Path, change: tuple[str, str], words: str) -> None:
    with pytest.raises(ConfigError, match=words) as caught:
        rig_with(tmp_path, change)
    assert "pressure_source" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_controller_is_the_sensor_of_a_rig_that_names_none(tmp_path: Path) -> None:
    config = rig_with(tmp_path, ('sensor = "pressure_transmitter"', 'sensor = "controller"'),
                      ("sensor_lag_s = 0.5 ", "# "), ("sensor_stale_s = 1.5 ", "# "))  # fmt: skip
    assert config.pressure_source.sensor == ""
    assert config.pressure_calibration is config.calibrations["pressure_kpa"]


# ---- a run ------------------------------------------------------------------------------


def test_points_report_and_diagnosis_have_the_pressure_of_the_transducer(tmp_path: Path) -> None:
    result, run = run_with(tmp_path, zero_s=0.3)
    assert result.outcome == "clean", result.error
    assert run.manifest["pressure_sensor"]["instrument"] == SENSOR
    table = reduce_run(run).table
    stream, own = run.samples(SENSOR), run.instrument_calibrations[SENSOR]
    points = [e for e in run.events if e["kind"] == "point"]
    assert len(points) == len(table) == 4
    valve, controller = run.samples("valve"), run.calibration("pressure_kpa")
    for row, event in zip(table.to_dict("records"), points, strict=True):
        first, end = event["pressure_rows"]
        assert end - first >= 8
        inside = (stream["row"] >= first) & (stream["row"] < end)
        mean = float(own.apply(stream["reading"][inside]).mean())
        assert row["pressure_kpa"] == mean
        assert row["u_pressure_kpa_cal"] == float(own.u(mean))
        low, high = event["valve_seq"]
        counts = valve["counts"][(valve["seq"] >= low) & (valve["seq"] < high)]
        assert 0.0 < abs(mean - float(controller.apply(counts.mean()))) < 2.0
        assert row["settled"]
    notes = " ".join(reduce_run(run).notes)
    assert "pressure is the reading of pressure_transmitter; the controller's own" in notes
    report = report_json(run)
    (calibration,) = (c for c in report["calibrations"] if c["quantity"] == "pressure_kpa")
    assert calibration["id"] == "PT-2026-03"
    assert len(report["zeros"]) == 2
    (trial,) = run_trials(run)
    pressures = trial.samples["pressure_kpa"].dropna()
    assert set(pressures) <= set(own.apply(stream["reading"]))
    assert json.dumps(report)
    assert isinstance(table, pd.DataFrame)


def test_readings_late_within_the_stated_lag_are_no_disagreement(tmp_path: Path) -> None:
    """While the muscle fills, a reading 0.35 s old is tens of kPa away from the controller's."""
    apart: list[float] = []

    def late(runner: Runner, bench: VirtualBench) -> None:
        device = transducer(bench)
        read, history = device._read, []
        runner.rig.event_loop.add(lambda: history.append((bench.time_s, read())))

        def old() -> float:
            past = [kpa for at_s, kpa in history if at_s <= bench.time_s - 0.35]
            kpa = past[-1] if past else read()
            apart.append(abs(kpa - bench.plant.pressure_kpa))
            return kpa

        device._read = old

    result, _ = run_with(tmp_path, late)
    assert result.outcome == "clean", result.error
    assert max(apart) > 50.0


# ---- faults -----------------------------------------------------------------------------


def test_a_reading_while_the_muscle_vents_is_no_disagreement(tmp_path: Path) -> None:
    """It is newer than the middle of the controller's last batch, and the pressure falls fast."""
    method = {"precondition_cycles": 2, "precondition_kpa": 500.0, "precondition_dwell_s": 0.5}
    result, _, _ = run_short("hysteresis", tmp_path, "virtual-transducer", method=method)
    assert result.outcome == "clean", result.error


def test_a_transducer_that_drifts_away_is_a_fault(tmp_path: Path) -> None:
    begin_s, rate = 5.0, 1.0
    result, run = run_with(
        tmp_path, distorted(lambda kpa, at_s: kpa + rate * max(0.0, at_s - begin_s))
    )
    said = check_faulted_and_vented(result, run)
    assert "pressure_transmitter" in said
    assert "where the controller reads" in said
    assert "may differ by" in said
    start_s = 4.0 + 4.0 / rate  # the band, its share by the calibrations, and the confirmation
    assert seconds_at(run, "end") < begin_s + start_s


def test_a_transducer_off_by_more_than_the_band_is_a_fault_at_the_first_point(
    tmp_path: Path,
) -> None:
    result, run = run_with(tmp_path, distorted(lambda kpa, at_s: kpa * 1.02))
    said = check_faulted_and_vented(result, run)
    assert "where the controller reads" in said
    assert not [e for e in run.events if e["kind"] == "point"]


def test_a_transducer_that_sticks_is_a_fault_when_the_pressure_moves(tmp_path: Path) -> None:
    held: list[float] = []

    def stick(kpa: float, at_s: float) -> float:
        held.append(kpa)
        return held[0]

    said = check_faulted_and_vented(*run_with(tmp_path, distorted(stick)))
    assert "where the controller reads" in said


def test_a_silent_transducer_is_a_fault_in_time(tmp_path: Path) -> None:
    silent_s: list[float] = []

    def mute(runner: Runner, bench: VirtualBench) -> None:
        def look() -> None:
            if runner.sensor.recent_kpa(50, 1)[-1] > 150.0 and not silent_s:
                transducer(bench).mute = True
                silent_s.append((runner.rig.clock.now_ns() - runner.record.start_ns) * 1e-9)

        runner.rig.event_loop.add(look)

    result, run = run_with(tmp_path, mute)
    said = check_faulted_and_vented(result, run)
    assert "no pressure reading for 1.5 s" in said
    assert "check its cable and power" in said
    ended = next(e["t_ns"] for e in run.events if e["kind"] == "vented") * 1e-9
    assert ended < silent_s[0] + 1.5 + 1.5  # the limit, then emptying the muscle


def test_a_transducer_that_is_unplugged_ends_the_run(tmp_path: Path) -> None:
    def pull(runner: Runner, bench: VirtualBench) -> None:
        def look() -> None:
            if runner.progress.done >= 1 and SENSOR in bench._device_ends:
                bench.unplug(SENSOR)

        runner.rig.event_loop.add(look)

    result, run = run_with(tmp_path, pull)
    said = check_faulted_and_vented(result, run)
    assert SENSOR in said
    assert "unplugged" in said
