"""Hung loads: swings faster than the camera's frames, and inertia that is only the camera's noise.

What frames show of such a swing means nothing: its rows count in no figure of a block. It had made
a floor of 75 N of settled loads that repeat to 0.3 N (investigation 699).

Accelerations are second differences of a length. Under 8 to 26 kg the noise of a good camera makes
newtons of inertia out of them, which another generator's nominal benches were called unknown for.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest

from gap.data.dataset import DataSet
from gap.data.reader import read_dataset
from gap.effects.candidates import CANDIDATES
from gap.estimation.cross_validation import floor_squares
from gap.estimation.fit_problem import FitProblem
from gap.model.features import BLOCKS
from gap.model.grid import make_grid
from gap.validation.maps import residual_maps

Array = npt.NDArray[np.float64]

FRAMES_HZ, LOAD_KG, PRESSURE_KPA = 30.0, 0.2, 300.0
SWING_MM, SWING_HZ = 0.3, 18.0


def hung(folder: Path, swings_s: float, seconds: float = 6.0) -> DataSet:
    """Three replicates of a load that bounces for a while on a muscle of constant pressure."""
    rng = np.random.default_rng(4)
    trials, samples = [], []
    for replicate in (1, 2, 3):
        name = f"load {replicate}"
        t = np.arange(0.0, seconds, 1.0 / FRAMES_HZ)
        # As fast as 0.2 kg bounces there: more than half the frame rate.
        swing = SWING_MM * np.sin(2.0 * np.pi * SWING_HZ * t + replicate) * (t < swings_s)
        trials.append({"trial": name, "slot": "load", "replicate": replicate,
                       "protocol": "isotonic", "load_kg": LOAD_KG})  # fmt: skip
        samples.append(pd.DataFrame({
            "trial": name, "time_s": t,
            "pressure_kpa": PRESSURE_KPA + 0.05 * rng.standard_normal(len(t)),
            "length_mm": 60.0 + swing + 0.003 * rng.standard_normal(len(t)),
        }))  # fmt: skip
    folder.mkdir()
    pd.DataFrame(trials).to_csv(folder / "trials.csv", index=False)
    pd.concat(samples).to_csv(folder / "samples.csv", index=False)
    return read_dataset(folder)


def test_rows_of_a_swing_that_frames_cannot_follow_stand_for_no_time(tmp_path: Path) -> None:
    rows = make_grid(hung(tmp_path / "set", swings_s=3.0, seconds=8.0)).rows
    load = rows.block == BLOCKS.index("load")
    assert np.sum(rows.span_s[load]) == pytest.approx(3 * 8.0, rel=0.02)
    assert np.sum(rows.compared_s[load]) == pytest.approx(3 * 5.0, rel=0.15)
    assert np.all(rows.compared_s[load & (rows.time_s < 2.0)] == 0.0)


def test_where_all_of_a_block_swings_all_of_it_is_compared(tmp_path: Path) -> None:
    rows = make_grid(hung(tmp_path / "set", swings_s=99.0)).rows
    assert np.array_equal(rows.compared_s, rows.span_s)


def floor_n(data: DataSet) -> float:
    problem = FitProblem.of(data, list(CANDIDATES))
    here = problem.rows.block == BLOCKS.index("load")
    squares = floor_squares(problem, problem.units)["load"].sum()
    return float(np.sqrt(squares / problem.rows.compared_s[here].sum()))


def test_the_floor_of_settled_loads_does_not_rise_by_how_they_came_to_rest(tmp_path: Path) -> None:
    still, swung = hung(tmp_path / "still", 0.0), hung(tmp_path / "swung", swings_s=3.0)
    assert floor_n(swung) < 1.1 * floor_n(still)


def test_the_courses_of_a_residual_leave_out_what_stands_for_no_time(tmp_path: Path) -> None:
    problem = FitProblem.of(hung(tmp_path / "set", swings_s=3.0, seconds=8.0), list(CANDIDATES))
    over = {course.over: course for course in residual_maps(problem, problem.base)}
    assert np.isfinite(over["time"].before).all()


def test_the_noise_of_a_slow_reading_of_length_is_no_swing(tmp_path: Path) -> None:
    data = cycled(tmp_path / "set", load_kg=10.0, noise_mm=0.04)
    rows = make_grid(data).rows
    load = rows.block == BLOCKS.index("load")
    assert np.sum(rows.compared_s[load]) > 0.9 * np.sum(rows.span_s[load])
    assert FitProblem.of(data, list(CANDIDATES)).noise.pairs > 0


def replicates(
    folder: Path, load_kg: float, time_s: Array, kpa: Array, length_mm: Array, noise_mm: float
) -> DataSet:
    """Three replicates of a load on a course of pressure and length, read with noise."""
    rng = np.random.default_rng(7)
    trials, samples = [], []
    for replicate in (1, 2, 3):
        name = f"load {replicate}"
        trials.append({"trial": name, "slot": "load", "replicate": replicate,
                       "protocol": "isotonic", "load_kg": load_kg})  # fmt: skip
        samples.append(pd.DataFrame({
            "trial": name, "time_s": time_s,
            "pressure_kpa": kpa + 0.05 * rng.standard_normal(len(time_s)),
            "length_mm": length_mm + noise_mm * rng.standard_normal(len(time_s)),
        }))  # fmt: skip
    folder.mkdir()
    pd.DataFrame(trials).to_csv(folder / "trials.csv", index=False)
    pd.concat(samples).to_csv(folder / "samples.csv", index=False)
    return read_dataset(folder)


def still(folder: Path, load_kg: float, noise_mm: float) -> DataSet:
    """A load that hangs still, seen by a camera of 100 frames a second."""
    t = np.arange(0.0, 6.0, 0.01)
    flat = np.ones(len(t))
    return replicates(folder, load_kg, t, PRESSURE_KPA * flat, 60.0 * flat, noise_mm)


def cycled(folder: Path, load_kg: float, noise_mm: float) -> DataSet:
    """A slow cycle under a load, read by a wire five times a second."""
    t = np.arange(0.0, 60.0, 0.2)
    way = np.abs(t / 30.0 - 1.0)
    return replicates(folder, load_kg, t, 500.0 - 200.0 * way, 58.0 + 8.0 * way, noise_mm)


@pytest.mark.parametrize(("load_kg", "noise_mm"), [(2.0, 0.02), (16.0, 0.02), (16.0, 0.05)])
def test_the_noise_of_a_camera_under_a_heavy_load_is_in_the_floor(
    tmp_path: Path, load_kg: float, noise_mm: float
) -> None:
    problem = FitProblem.of(still(tmp_path / "set", load_kg, noise_mm), list(CANDIDATES))
    off = problem.base.residual - np.median(problem.base.residual)
    beyond = np.abs(off) > 2.5 * np.sqrt(problem.floor_variance)
    assert np.mean(beyond) < 0.03
