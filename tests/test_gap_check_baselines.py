"""The naive methods do what their names say, and fail where theory says they must."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from gap.check.scoring.baselines import (
    Features,
    by_bic,
    by_random_folds,
    by_sparse_regression,
    verdict_of,
)

ROWS = 1200
T = np.linspace(0.0, 1.0, ROWS)
KEYS = (("creep", "rate"), ("bladder_elasticity", "elasticity"), ("leak", "flow"))


def made(noise: np.ndarray, amount: float = 0.0) -> Features:
    candidates = np.column_stack([1.0 - np.exp(-3.0 * T), T**3, np.sin(40.0 * T)])
    constants = np.column_stack([np.ones(ROWS), T])
    y = noise + amount * candidates[:, 2]
    return Features(y, constants, candidates, KEYS)


def white(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(ROWS)


def correlated(seed: int) -> np.ndarray:
    a = np.exp(-1.0 / 150.0)
    return np.asarray(lfilter([np.sqrt(1 - a * a)], [1.0, -a], white(seed)))


@pytest.mark.parametrize("method", [by_bic, by_random_folds])
def test_a_clear_effect_in_white_noise_is_found(method) -> None:
    assert method(made(white(1), 1.0)) == 2


def test_sparse_regression_finds_it_too() -> None:
    assert by_sparse_regression(made(white(1), 1.0))[0] == 2


def test_bic_keeps_quiet_in_white_noise_and_raises_alarms_in_correlated_noise() -> None:
    """Section 4.1 of the field notes: independent errors are its assumption, and they are not."""
    assert sum(by_bic(made(white(i))) is not None for i in range(20)) == 0
    assert sum(by_bic(made(correlated(i))) is not None for i in range(20)) >= 15


def test_random_folds_are_fooled_by_correlation_as_well() -> None:
    assert sum(by_random_folds(made(correlated(i))) is not None for i in range(10)) >= 8


def test_a_verdict_is_always_sure_of_itself() -> None:
    none, one = verdict_of([]), verdict_of([KEYS[2]])
    assert none["status"] == "no_gap_above_floor"
    assert none["probability_none"] == 1.0
    assert one["effects"][0]["ids"] == ["leak"]
    assert one["stage"] == "valve"
