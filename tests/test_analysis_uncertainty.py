"""Does twice the stated type A uncertainty hold the true mean as often as it says?"""

from __future__ import annotations

import math

import numpy as np
import pytest

from analysis.reduction.uncertainty import correlation_time, window_mean


def ar1(rng: np.random.Generator, phi: float, runs: int, n: int) -> np.ndarray:
    steps = rng.normal(size=(runs, n))
    series = np.empty_like(steps)
    series[:, 0] = steps[:, 0] / math.sqrt(1 - phi**2)
    for i in range(1, n):
        series[:, i] = phi * series[:, i - 1] + steps[:, i]
    return series


@pytest.mark.parametrize(("phi", "n"), [(0.0, 10), (0.0, 500), (0.5, 100), (0.8, 500), (0.9, 1000)])
def test_twice_u_covers_the_mean_of_correlated_noise(phi: float, n: int) -> None:
    rng = np.random.default_rng(7)
    means = [window_mean(series) for series in ar1(rng, phi, 800, n)]
    inside = np.mean([abs(mean.mean) <= 2 * mean.u for mean in means])
    assert 0.93 <= inside <= 0.985


@pytest.mark.parametrize(("phi", "n", "least"), [(0.8, 100, 0.91), (0.9, 100, 0.87)])
def test_a_window_of_few_correlation_times_falls_short_only_a_little(
    phi: float, n: int, least: float
) -> None:
    rng = np.random.default_rng(7)
    means = [window_mean(series) for series in ar1(rng, phi, 1500, n)]
    assert least <= np.mean([abs(mean.mean) <= 2 * mean.u for mean in means]) <= 0.96


def test_a_naive_standard_error_would_have_failed_the_same_test() -> None:
    rng = np.random.default_rng(7)
    series = ar1(rng, 0.8, 400, 500)
    naive = series.std(axis=1, ddof=1) / math.sqrt(500)
    assert np.mean(np.abs(series.mean(axis=1)) <= 2 * naive) < 0.6


def test_correlation_time_of_ar1_is_what_theory_says() -> None:
    rng = np.random.default_rng(3)
    taus = [correlation_time(series) for series in ar1(rng, 0.8, 50, 4000)]
    assert np.mean(taus) == pytest.approx((1 + 0.8) / (1 - 0.8), rel=0.1)


def test_a_steady_reading_is_known_to_its_resolution_only() -> None:
    mean = window_mean(np.full(100, 12.5), resolution=0.5)
    assert mean.u == pytest.approx(0.5 / math.sqrt(12))


def test_rounding_that_noise_carries_over_its_steps_averages_out() -> None:
    rng = np.random.default_rng(1)
    true = 100.31
    errors = []
    for _ in range(300):
        mean = window_mean(np.round(true + rng.normal(0, 1.0, 400)), resolution=1.0)
        assert mean.u < 0.08 < 1 / math.sqrt(12)
        errors.append(abs(mean.mean - true) <= 2 * mean.u)
    assert np.mean(errors) > 0.92


def test_nothing_and_a_single_reading_claim_no_noise_figure() -> None:
    assert math.isnan(window_mean(np.empty(0)).mean)
    assert math.isnan(window_mean(np.array([3.0])).u)
    assert window_mean(np.array([3.0]), 0.1).u == pytest.approx(0.1 / math.sqrt(12))
