"""What repeats in time or length, and has no name: a period, its form, and a plant file with it."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gap.data.reader import read_dataset
from gap.estimation.cross_validation import held_out
from gap.estimation.fit_problem import FitProblem
from gap.reason import Cause, Reason
from gap.reporting.empirical import empirical_figure, empirical_lines
from gap.validation.empirical import empirical_term
from gap.validation.improved_plant import improved_plant
from gap.validation.terms.waves import Wave, WaveRows, waves_of
from gap.verdict import Gap, Status, Verdict
from gap_bench import write_set
from plant.effects.empirical import WAVES, Correction, Corrections, SplineTerm, wave_columns

Array = npt.NDArray[np.float64]

RIPPLE_S = 0.137
SLOTS = 5


def rows_with(wave: Array, seed: int = 1) -> tuple[WaveRows, Array]:
    """Rows of five slots of two trials each, every 20 ms for 4 s, and their time in the trial."""
    rng = np.random.default_rng(seed)
    count = wave.shape[1]
    time = np.tile(0.02 * np.arange(count), 2 * SLOTS)
    slot = np.repeat(np.arange(SLOTS), 2 * count)
    trial = np.repeat(np.arange(2 * SLOTS), count)
    values = wave[slot, np.tile(np.arange(count), 2 * SLOTS)] + rng.normal(0.0, 0.3, len(slot))
    span = np.full(len(slot), 0.02)
    return WaveRows(values, span, trial, slot, np.ones(len(slot)), span), time


def found(rows: WaveRows, time: Array) -> list[Wave]:
    return waves_of(rows, {"time_s": time})


TIME = 0.02 * np.arange(200)


def test_one_period_and_phase_in_all_slots_is_found() -> None:
    (wave,) = found(*rows_with(np.tile(np.sin(2 * np.pi * TIME / RIPPLE_S + 0.4), (SLOTS, 1))))
    assert (wave.input, wave.scale) == ("time_s", "")
    assert wave.period == pytest.approx(RIPPLE_S, rel=2e-3)


def test_a_hum_too_fast_for_each_trial_is_told_by_trials_that_are_read_otherwise() -> None:
    """50 Hz, of means of four readings every 3, 4 or 5 ms: in each of the rates it looks slower."""
    rng = np.random.default_rng(3)
    hum, apart, trial = [], [], []
    times = []
    for k in range(2 * SLOTS):
        every = (0.003, 0.004, 0.005)[k % 3]
        read = every * np.arange(800).reshape(-1, 4)
        times.append(read.mean(axis=1))
        hum.append(np.sin(2 * np.pi * 50.0 * read + 0.4).mean(axis=1))
        apart.append(np.full(len(read), every))
        trial.append(np.full(len(read), k))
    time, numbers = np.concatenate(times), np.concatenate(trial)
    values = np.concatenate(hum) + rng.normal(0.0, 0.3, len(time))
    samples = np.full(len(time), 4.0)
    rows = WaveRows(
        values, np.ones(len(time)), numbers, numbers // 2, samples, np.concatenate(apart)
    )
    (wave,) = found(rows, time)
    assert wave.period == pytest.approx(0.02, rel=1e-3)


def test_of_hums_that_all_trials_show_alike_the_slowest_is_meant() -> None:
    """47 Hz read every 20 ms is 3 Hz: no trial tells which it is."""
    fast = np.sin(2 * np.pi * 47.0 * TIME + 0.4)
    (wave,) = found(*rows_with(np.tile(fast, (SLOTS, 1))))
    assert wave.period == pytest.approx(1.0 / 3.0, rel=2e-3)


@pytest.mark.parametrize("seed", range(5))
def test_noise_has_no_period(seed: int) -> None:
    assert found(*rows_with(np.zeros((SLOTS, len(TIME))), seed)) == []


def test_what_one_slot_alone_shows_is_a_chance() -> None:
    alone = np.zeros((SLOTS, len(TIME)))
    alone[2] = 3.0 * np.sin(2 * np.pi * TIME / RIPPLE_S)
    assert found(*rows_with(alone)) == []


def test_phases_of_their_own_say_nothing_of_a_further_slot() -> None:
    phase = np.array([0.0, 1.3, 2.5, 3.8, 5.0])[:, None]
    assert found(*rows_with(np.sin(2 * np.pi * TIME / RIPPLE_S + phase))) == []


def test_a_slow_drift_of_a_trial_is_no_wave() -> None:
    assert found(*rows_with(np.tile(0.8 * TIME - 0.15 * TIME**2, (SLOTS, 1)))) == []


@given(
    period=st.floats(0.01, 10.0), amount=st.floats(-3.0, 3.0), turn=st.floats(0.0, 6.2),
    halves=st.floats(-3.0, 3.0),
)  # fmt: skip
def test_a_term_goes_on_beyond_its_knots_and_comes_back_from_a_file(
    period: float, amount: float, turn: float, halves: float
) -> None:
    own = (amount * np.cos(turn), -amount * np.sin(turn), halves, 0.0)
    correction = Correction(
        "pressure", (SplineTerm(("time_s",), ((0.0, 1.0),), own, period=period),)
    )
    assert (
        Corrections.from_config({"pressure": correction.as_config()}).of["pressure"] == correction
    )
    x = np.linspace(-3.0, 7.0, 41)
    angle = 2 * np.pi * x / period
    expected = amount * np.cos(angle + turn) + halves * np.cos(2.0 * angle)
    assert correction.value({"time_s": x}, 41) == pytest.approx(expected, abs=1e-7)
    again = correction.value({"time_s": x + period}, 41)
    assert again == pytest.approx(expected, abs=1e-7)


def test_the_mean_over_whole_periods_is_nothing() -> None:
    x = np.linspace(0.0, 2.0, 400, endpoint=False)
    columns = wave_columns(x, 0.5)
    assert columns.shape == (400, WAVES)
    assert columns.mean(axis=0) == pytest.approx(np.zeros(WAVES), abs=1e-12)


def test_a_gauge_that_hums_gets_a_term_with_its_period_and_the_plant_file_takes_it(
    tmp_path: Path,
) -> None:
    """A ripple that begins with every trial, 4 kPa: rows of a slow stretch show nothing of it."""
    folder = write_set(tmp_path / "data", {}, seed=4)
    samples = pd.read_parquet(folder / "samples.parquet")
    own = samples["pressure_kpa"].notna()
    start = samples.groupby("trial")["time_s"].transform("min")
    hum = 4.0 * np.sin(2 * np.pi * (samples["time_s"] - start) / RIPPLE_S)
    samples.loc[own, "pressure_kpa"] += hum[own]
    samples.to_parquet(folder / "samples.parquet")
    problem = FitProblem.of(read_dataset(folder))
    term = empirical_term(problem, problem.base, block="pressure")
    assert term is not None
    assert term.closed > 0.5
    assert max(term.shares, key=term.shares.__getitem__) == "history"
    periods = [one.period for one in term.correction.terms if one.period]
    assert periods == [pytest.approx(RIPPLE_S, rel=3e-3)]
    channels = tuple(Gap(unit, 1.0, 1.0, None, None, None) for unit in ("N", "kPa"))
    verdict = Verdict(
        Status.UNKNOWN, Reason(Cause.NO_GAP), "muscle", (), 0.1, 0.9,
        empirical=term, channels=channels,
    )  # fmt: skip
    assert verdict.headline_gap is channels[1]
    alike = tuple(Gap("N", off, off, None, None, None) for off in (3.0, term.recalibrated))
    of_load = replace(verdict, empirical=replace(term, unit="N"), channels=alike)
    assert of_load.headline_gap is alike[1]
    assert "an addition that repeats every 0.137 s" in "\n".join(empirical_lines(verdict))
    assert verdict.as_dict()["empirical"]["terms"][0]["period"] == pytest.approx(RIPPLE_S, rel=3e-3)
    figure = empirical_figure(term)
    assert figure is not None
    assert figure.axes[0].get_xlabel() == "time in the trial, s"
    text = improved_plant(problem, problem.base, term)
    assert tomllib.loads(text)["empirical"]["pressure"]["terms"][0]["period"] == periods[0]
    (folder / "bench.toml").write_text(text)
    again = FitProblem.of(read_dataset(folder))
    one, two = (held_out(p, p.base)["pressure"].rms("recalibrated") for p in (problem, again))
    assert two < 0.6 * one
