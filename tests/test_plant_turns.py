"""A recorded path between its turns, without what its noise makes of it."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import isotonic_regression

from plant.physics.paths import between_turns

Array = npt.NDArray[np.float64]
SD = 0.018
"""Noise in mm of the laser on the cylinder of E. Zillen."""


def smoothed(x: Array, sd: float = SD) -> Array:
    made = np.empty(len(x))
    first = np.array([0, len(x)], dtype=np.int64)
    between_turns(first, np.ascontiguousarray(x, dtype=np.float64), np.array([sd]), made)
    return made


def strokes(*ends: float, step: float = 0.11) -> Array:
    """A path from end to end at a steady speed."""
    parts = [
        np.linspace(a, b, max(round(abs(b - a) / step), 1), endpoint=False)
        for a, b in pairwise(ends)
    ]
    return np.asarray(np.r_[np.concatenate(parts), ends[-1]])


def noisy(x: npt.ArrayLike, seed: int = 0) -> Array:
    return np.asarray(np.asarray(x) + SD * np.random.default_rng(seed).standard_normal(np.shape(x)))


@given(st.lists(st.floats(-50, 50), min_size=3, max_size=6, unique=True))
def test_a_path_without_noise_stays_as_it_is(ends: list[float]) -> None:
    path = strokes(*ends)
    assert smoothed(path, 0.0) == pytest.approx(path, abs=1e-12)


@given(st.integers(0, 1000), st.floats(0.03, 0.2))
def test_a_path_that_does_not_turn_is_the_isotonic_regression_of_scipy(
    seed: int, step: float
) -> None:
    path = noisy(step * np.arange(200), seed)
    assert smoothed(path) == pytest.approx(isotonic_regression(path).x, abs=1e-12)


@pytest.mark.parametrize("step", [0.05, 0.11, 0.3])
def test_a_turn_stays_where_it_is(step: float) -> None:
    """A play of six sd lags behind by as much after each turn, 0.1 mm here."""
    true = strokes(0, 40, 0, 40, 0, step=step)
    made = smoothed(noisy(true))
    off = made - true
    # Far from level nothing is pooled, so that the noise stays: one sd, and chance on top.
    assert float(np.sqrt(np.mean(off**2))) < 1.1 * SD
    assert float(np.abs(off).max()) < 4.0 * SD
    turns = [int(k) for k in np.flatnonzero(np.diff(np.sign(np.diff(true))) != 0) + 1]
    after = np.concatenate([off[k + 1 : k + 12] for k in turns])
    assert abs(float(after.mean())) < SD


def test_a_rest_before_a_turn_is_one_level_whatever_stands_out() -> None:
    path = noisy(np.r_[strokes(0, 20), np.full(2000, 20.0), strokes(20, 0)], 3)
    made = smoothed(path)[len(strokes(0, 20)) + 20 : -len(strokes(0, 20)) - 20]
    assert float(np.ptp(made)) < 0.5 * SD


def test_each_trial_is_a_path_of_its_own() -> None:
    one, other = noisy(strokes(0, 10, 0)), noisy(strokes(30, 5, 30), 1)
    made = np.empty(len(one) + len(other))
    first = np.array([0, len(one), len(made)], dtype=np.int64)
    between_turns(first, np.r_[one, other], np.array([SD, SD]), made)
    assert np.array_equal(made, np.r_[smoothed(one), smoothed(other)])
