"""The naive methods do what their names say, and fail where theory says they must."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import multivariate_normal

from gap.check.scoring.baselines import (
    Features,
    by_bic,
    by_random_folds,
    by_sparse_regression,
    verdict_of,
)
from gap.check.scoring.spike_and_slab import WAVES, LinearModel, posterior

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


def linear(seed: int, amounts: dict[int, float], discrepancy: float = 0.0) -> LinearModel:
    """White noise of one, two constants, three effects with waves of their forms."""
    rng = np.random.default_rng(seed)
    constants, own = np.column_stack([np.ones(ROWS), T]), made(white(seed)).candidates
    waves = np.cos(np.arange(1, WAVES + 1) * (1.0 + 2.0 * T[:, None]))
    each = [own[:, [j]] * np.hstack([np.ones((ROWS, 1)), waves]) for j in range(3)]
    columns = np.hstack([constants, waves, *each])
    y = white(seed) + 0.5 * constants[:, 1] + discrepancy * waves @ rng.standard_normal(WAVES)
    y = y + sum(amount * own[:, j] for j, amount in amounts.items())
    gram = columns.T @ columns
    gram[[0, 1], [0, 1]] += 1.0
    size = np.sqrt(ROWS / np.sum(own**2, axis=0))
    return LinearModel(gram, columns.T @ y, 2, WAVES, tuple(k for k, _ in KEYS), size)


def test_the_evidence_of_the_posterior_is_the_density_of_the_data() -> None:
    """SciPy's multivariate normal with the covariance that the priors make."""
    rng = np.random.default_rng(0)
    x, y = rng.standard_normal((40, 5)), rng.standard_normal(40)
    gram = x.T @ x
    gram[[0, 1], [0, 1]] += 1.0
    model = LinearModel(gram, x.T @ y, 2, 0, (), np.empty(0))

    def expected(columns: list[int], prior: list[float]) -> float:
        own = x[:, columns] / np.sqrt([1.0, 1.0, *prior])
        cover = np.eye(40) + own @ own.T
        return float(multivariate_normal(np.zeros(40), cover).logpdf(y))

    one, other = ([0, 1, 2], [4.0]), ([0, 1, 3, 4], [0.5, 9.0])
    found = [model._posterior(columns, np.array(prior))[0] for columns, prior in (one, other)]
    assert found[1] - found[0] == pytest.approx(expected(*other) - expected(*one), abs=1e-6)


def test_the_posterior_finds_effects_together_and_nothing_in_noise() -> None:
    nothing, two = posterior(linear(2, {})), posterior(linear(2, {1: 3.0, 2: 2.0}))
    assert sum(sum(p) for p in two.values()) == pytest.approx(1.0)
    assert nothing[()][0] > 0.8
    assert sum(two["bladder_elasticity", "leak"]) > 0.8


def test_a_discrepancy_is_no_effect() -> None:
    found = posterior(linear(3, {}, discrepancy=2.0))
    assert found[()][1] > 0.8
