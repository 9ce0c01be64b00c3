"""The dynamic test: frequency responses against the virtual bench's true state, and their noise."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import signal

from analysis.findings.muscle.dynamic import NO_WORK
from analysis.reduction.muscle.energy import Air
from analysis.reduction.muscle.response import (
    PRESSURE_FORCE,
    PRESSURE_LENGTH,
    SET_PRESSURE,
    Signal,
    chirp_responses,
    estimate,
    mean_period,
    sine_response,
    sweep_coefficients,
)
from analysis.registry import analysis_of
from analysis.reporting.derived import derive_all
from analysis.run_table import reduce_run
from daq.errors import ConfigError
from daq.store.run import Run
from daq.store.verify import verify
from protocol_runs import events, force_n, run_short
from rigs.execution.runner import Runner
from rigs.protocols.muscle.dynamic import Chirp, Sines
from rigs.protocols.registry import procedure
from rigs.rigfile.config import load_rig
from rigs.rigfile.toml_reader import find_config
from rigs.steps.muscle.excite import chirp_phase

Truth = list[tuple[int, float, float]]


def watched(truth: Truth) -> Any:
    """A hook that notes host time, true pressure and true length of the bench in every round."""

    def begin(runner: Runner) -> None:
        bench = runner.rig.bench
        assert bench is not None
        runner.rig.event_loop.add(
            lambda: truth.append(
                (runner.rig.clock.now_ns(), bench.plant.pressure_kpa, bench.plant.length_mm)
            )
        )

    return begin


def run_dynamic(root: Path, rig: str, **changes: Any) -> tuple[Run, Truth]:
    truth: Truth = []
    result, run, _ = run_short("dynamic", root, rig, begin=watched(truth), **changes)
    assert result.outcome == "clean", result.error
    return run, truth


def true_sine(run: Run, truth: Truth, event: dict[str, Any], column: int) -> complex:
    """Complex amplitude of the true state over the periods that count."""
    start_ns = run.manifest["started"]["monotonic_ns"]
    t = (np.array([row[0] for row in truth]) - start_ns - event["start_t_ns"]) * 1e-9
    begin = (event["counted_t_ns"] - event["start_t_ns"]) * 1e-9
    use = (t >= begin) & (t < begin + event["periods"] * event["period_s"])
    y = np.array([row[column] for row in truth])[use]
    angle = 2 * math.pi * event["low_hz"] * t[use]
    found = np.linalg.lstsq(
        np.column_stack([np.ones(len(y)), np.cos(angle), np.sin(angle)]), y, rcond=None
    )[0]
    return complex(found[1], -found[2])


@pytest.fixture(scope="module")
def solenoids(tmp_path_factory: pytest.TempPathFactory) -> tuple[Run, Truth]:
    return run_dynamic(
        tmp_path_factory.mktemp("dynamic"), "virtual", sines=Sines((0.5, 2.0), 6, 0.0, 0.5)
    )


def test_gain_and_phase_of_the_pressure_are_the_true_ones(solenoids: tuple[Run, Truth]) -> None:
    run, truth = solenoids
    table = reduce_run(run).table
    for event in events(run, "point"):
        (row,) = table[
            (table["order"] == event["order"]) & (table["pair"] == SET_PRESSURE)
        ].to_dict("records")
        # A sine that was sent begins at phase 0: -j times its amplitude.
        true = true_sine(run, truth, event, 1) / (-1j * event["amplitude_kpa"])
        # The set-point stands still between two updates, on the average for half of 20 ms.
        held = math.radians(360 * event["low_hz"] * 0.01)
        # The sensor errs by its calibration, and the samples come a few ms after the state.
        assert row["gain"] == pytest.approx(abs(true), rel=0.02)
        expected = math.degrees(math.atan2(true.imag, true.real) + held)
        assert row["phase_deg"] == pytest.approx(expected, abs=2.0 + 360 * event["low_hz"] * 0.005)
        assert row["coherence"] > 0.99


def test_force_follows_pressure_as_in_the_plant(solenoids: tuple[Run, Truth]) -> None:
    table = reduce_run(solenoids[0]).table
    part = table[table["pair"] == PRESSURE_FORCE]
    assert len(part) == 2
    for row in part.itertuples():
        assert abs(row.gain - force_n(1.0, 62.0)) < 3.0 * row.u_gain
        assert abs(row.phase_deg) < 3.0 * row.u_phase_deg


def test_record_and_report_of_a_dynamic_test(solenoids: tuple[Run, Truth]) -> None:
    run = solenoids[0]
    assert verify(run) == []
    assert "setpoint" in run.streams
    found = analysis_of("dynamic").findings(run, reduce_run(run))
    assert "Responses were measured from 0.5 to 2 Hz" in found.headline


def test_pages_of_a_dynamic_test_are_made_again_alike(solenoids: tuple[Run, Truth]) -> None:
    first = derive_all(solenoids[0].folder)
    text = first.derived("report.html").read_text()
    assert text.count("<svg") + text.count("image/svg") >= 2
    assert derive_all(solenoids[0].folder).derived("report.html").read_text() == text


def test_a_regulator_a_load_and_sweeps(tmp_path: Path) -> None:
    run, truth = run_dynamic(
        tmp_path, "virtual-laser", length_mm=0.0, mass_kg=1.154, sines=Sines((1.0,), 4, 0.0, 0.5),
        chirp=Chirp(0.5, 4.0, 4.0, 3), air=AIR,
    )  # fmt: skip
    table = reduce_run(run).table
    row = table[(table["pair"] == PRESSURE_LENGTH) & (table["shape"] == "sine")].iloc[0]
    event = events(run, "point")[0]
    true = true_sine(run, truth, event, 2) / true_sine(run, truth, event, 1)
    assert row["gain"] == pytest.approx(abs(true), rel=0.05)
    assert abs(row["phase_deg"]) > 150.0  # it shortens as the pressure rises
    sweeps = table[(table["pair"] == SET_PRESSURE) & (table["shape"] == "chirp")]
    assert len(sweeps) >= 6
    work_is_the_true_one(run, truth, event)
    run, _ = run_dynamic(tmp_path, "virtual-vppm", sines=Sines((1.0,), 4, 0.0, 1.0))
    assert reduce_run(run).table["coherence"].min() > 0.99


AIR = Air(600.0, 5.0, 101.3, 0.5, (51.0, 60.0, 72.5), (10.0, 8.0, 5.0), 1.0, 0.3)


def work_is_the_true_one(run: Run, truth: Truth, event: dict[str, Any]) -> None:
    """Stroke, work and efficiency of the sine against the state of the bench."""
    found = analysis_of("dynamic").findings(run, reduce_run(run))
    (energy,) = found.data["energy"]
    start_ns = run.manifest["started"]["monotonic_ns"]
    t = (np.array([row[0] for row in truth]) - start_ns - event["counted_t_ns"]) * 1e-9
    use = (t >= 0.0) & (t < event["periods"] * event["period_s"])
    kpa, mm = (np.array([row[k] for row in truth])[use] for k in (1, 2))
    stroke = float(np.ptp(mm))
    assert abs(energy["stroke_mm"] - stroke) < 3.0 * energy["u_stroke_mm"] + 0.01 * stroke
    weight = 1.154 * run.manifest["conditions"]["gravity_m_s2"]
    assert energy["work_j"] == pytest.approx(weight * energy["stroke_mm"] * 1e-3)
    pv = [(p + 101.3) * AIR.volume_ml(length) for p, length in zip(kpa, mm, strict=True)]
    exergy = float(np.ptp(pv)) * math.log(701.3 / 101.3) * 1e-3
    assert abs(energy["exergy_j"] - exergy) < 3.0 * energy["u_exergy_j"]
    assert energy["efficiency"] == pytest.approx(energy["work_j"] / energy["exergy_j"])


def test_without_a_moving_load_the_page_says_why_there_is_no_work(
    solenoids: tuple[Run, Truth],
) -> None:
    run = solenoids[0]
    found = analysis_of("dynamic").findings(run, reduce_run(run))
    (section,) = [s for s in found.sections if s.title == "Work and efficiency"]
    assert section.words == (NO_WORK,)
    assert found.data["energy"] == []


@pytest.mark.parametrize("noise", [0.02, 0.2])
def test_the_stroke_is_as_uncertain_as_stated(noise: float) -> None:
    rng = np.random.default_rng(7)
    t = np.arange(0.0, 8.0, 0.02)
    phase = 2 * math.pi * 0.5 * (t - 0.3)
    course = 60.0 + 0.01 * t + 2.0 * np.sin(phase) + 0.3 * np.sin(3 * phase)
    true = np.ptp(2.0 * np.sin(w := np.linspace(0, 2 * math.pi, 5000)) + 0.3 * np.sin(3 * w))
    inside = 0
    for _ in range(200):
        found = mean_period(Signal(t, course + noise * rng.normal(size=len(t))), 0.5, 0.0, 4)
        assert found is not None
        inside += abs(np.ptp(found.values) - true) <= 2 * 2.0 * found.u
    assert 186 <= inside <= 199


def test_higher_sines_are_left_out_when_the_pressure_does_not_follow(tmp_path: Path) -> None:
    run, _ = run_dynamic(
        tmp_path, "virtual-vppm", sines=Sines((1.0, 8.0, 10.0), 3, 0.5, 0.3), stop_below=0.5
    )
    assert [event["low_hz"] for event in events(run, "point")] == [1.0, 8.0]
    (stopped,) = events(run, "saturated")
    assert stopped["low_hz"] == 8.0
    assert "of the set-point's" in stopped["reason"]
    found = analysis_of("dynamic").findings(run, reduce_run(run))
    assert "did not follow" in found.headline


# ---- the estimator alone ----------------------------------------------------------------


def filtered(x: np.ndarray, rate_hz: float) -> np.ndarray:
    return np.asarray(signal.lfilter(*signal.butter(2, 3.0, fs=rate_hz), x))


def test_sweeps_give_what_welch_gives() -> None:
    """scipy's cross spectra over whole sweeps, as another way to the same numbers."""
    rate, sweep, sweeps = 200.0, 10.0, 5
    t = np.arange(0, sweep * (sweeps + 1), 1 / rate)
    x = np.sin([chirp_phase(s % sweep, 0.2, 8.0, sweep) for s in t])
    rng = np.random.default_rng(2)
    y = filtered(x, rate) + 0.05 * rng.normal(size=len(x))
    n = round(sweep * rate)
    use = t >= sweep
    how: dict[str, Any] = {"fs": rate, "window": "boxcar", "nperseg": n, "noverlap": 0}
    f, sxy = signal.csd(x[use], y[use], **how)
    _, sxx = signal.welch(x[use], **how)
    edges = sweep * np.arange(1.0, sweeps + 2.0)
    at = np.flatnonzero((f > 0.5) & (f < 6.0))
    xs = sweep_coefficients(Signal(t, x), f[at], edges)
    ys = sweep_coefficients(Signal(t, y), f[at], edges)
    for k, index in enumerate(at):
        found = estimate(float(f[index]), xs[:, k], ys[:, k])
        assert found is not None
        assert found.gain == pytest.approx(abs(sxy[index] / sxx[index]), rel=0.01)
    bands = chirp_responses(Signal(t, x), Signal(t, y), (0.2, 8.0), sweep, sweeps)
    b, a = signal.butter(2, 3.0, fs=rate)
    for band in (band for band in bands if band.frequency_hz < 4.0):
        _, h = signal.freqz(b, a, worN=[band.frequency_hz], fs=rate)
        assert band.gain == pytest.approx(abs(h[0]), rel=0.05)


@pytest.mark.parametrize("noise", [0.1, 1.0])
def test_gain_and_phase_are_as_uncertain_as_stated(noise: float) -> None:
    rng = np.random.default_rng(5)
    t = np.arange(0.0, 8.0, 0.02)
    x = np.sin(2 * math.pi * t)
    inside = 0
    for _ in range(300):
        y = 0.7 * np.sin(2 * math.pi * t - 0.5) + noise * rng.normal(size=len(t))
        found = sine_response(Signal(t, x), Signal(t, y), 1.0, 0.0, 8)
        assert found is not None
        inside += abs(found.gain - 0.7) <= 2 * found.u_gain
        inside += abs(math.radians(found.phase_deg) + 0.5) <= 2 * math.radians(found.u_phase_deg)
    assert 0.92 <= inside / 600 <= 0.99


def test_no_response_beyond_what_the_readings_can_show() -> None:
    t = np.arange(0.0, 10.0, 0.1)
    y = np.sin(2 * math.pi * 6.0 * t)
    assert sine_response(Signal(t, y), Signal(t, y), 6.0, 0.0, 60) is None


@pytest.mark.parametrize(
    ("old", "new", "rig", "words"),
    [
        ("amplitudes_kpa = [40]", "amplitudes_kpa = [400]", "virtual", "goes beyond 5 to 650 kPa"),
        ("[1, 2, 4]", "[1, 20]", "virtual", "fewer than four set-points in a period of 20 Hz"),
        ("periods = 3", "periods = 2", "virtual", "periods: .*outside 3"),
        ("[sines]", "[sine]", "virtual", "nothing is measured"),
        ("", "", "docs/make/examples/rigs/by-hand.toml", "a person turns the regulator"),
    ],
)
def test_a_file_that_cannot_be_run_is_refused(
    old: str, new: str, rig: str, words: str, tmp_path: Path
) -> None:
    path = tmp_path / "own.toml"
    path.write_text(find_config("dynamic-short", "protocols")[0].replace(old, new))
    with pytest.raises(ConfigError, match=words):
        procedure("dynamic").read(str(path), load_rig(rig))
