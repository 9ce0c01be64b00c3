"""Fits of the numbers of a shape: where a knee is, how soon it saturates, how fast it decays.

The candidates stand a few steps apart in such numbers. Once one is chosen, its numbers are fitted
together with amounts and constants. Otherwise an effect that lies between two candidates would move
the constants, leave a pattern, and look like an effect from outside the catalogue.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from gap.effects.candidates import Candidate
from gap.estimation.fit_problem import FitProblem, FitResult
from gap.estimation.information import damped_step
from plant.arrays import Array

_ROUNDS = 8
_STEP = 0.05
"""Change of a number's logarithm at which its signature is taken."""
_STRIDE = 0.8
"""Largest change of a logarithm in one round."""
_LEAST_SAMPLES = 3.0
"""Samples that a time constant of a force must last. A matter of definition."""
LOOSE = 1.0
"""Sd of a number's logarithm about that of the candidate it came from."""


def fit_shapes(problem: FitProblem, fit: FitResult) -> FitResult:
    """The fit with the free numbers of its candidates' shapes fitted too.

    Gauss and Newton over constants, amounts and the logarithms of those numbers, each within its
    range. Returns `fit` itself where nothing is free or better.
    """
    free = [(j, key) for j, s in enumerate(fit.candidates) for key in s.free]
    if not free:
        return fit
    start = _numbers(fit.candidates, free)
    constants = problem.columns_near(fit)
    damping = 1e-4
    for _ in range(_ROUNDS):
        at = _numbers(fit.candidates, free)
        slopes = np.hstack(
            [problem.slopes(fit.shift, fit.candidates, fit.amounts), _slopes(problem, fit, free)]
        )
        matrix, right = problem.normal(np.hstack([constants, slopes]), fit.residual, fit.shift)
        last = range(len(matrix) - len(free), len(matrix))
        matrix[last, last] += 1.0 / LOOSE**2
        right[-len(free) :] -= (at - start) / LOOSE**2
        better = None
        for _ in range(4):
            beta = damped_step(matrix, right, damping)
            trial = _moved(problem, fit, beta, free)
            if trial.cost + _prior(trial, free, start) < fit.cost + _prior(fit, free, start):
                better = trial
                break
            damping = max(damping, 1e-3) * 10.0
        if better is None:
            break
        damping /= 10.0
        gained = fit.cost - better.cost
        fit = better
        if gained < max(1.0, 1e-3 * fit.cost):
            break
    return fit


def _numbers(candidates: Sequence[Candidate], free: list[tuple[int, str]]) -> Array:
    return np.asarray(np.log([candidates[j].shape[key] for j, key in free]))


def _prior(fit: FitResult, free: list[tuple[int, str]], start: Array) -> float:
    return float(np.sum((_numbers(fit.candidates, free) - start) ** 2)) / LOOSE**2


def _with(
    problem: FitProblem,
    candidates: Sequence[Candidate],
    free: list[tuple[int, str]],
    logs: Array,
) -> list[Candidate]:
    """Suspects with their free numbers set, each within its range.

    A force that follows its cause in less than a few samples only takes noise off that cause.
    """
    made = list(candidates)
    for (j, key), log in zip(free, logs.tolist(), strict=True):
        low, high = made[j].free[key]
        if key == "tau_s" and "pressure" not in made[j].blocks:
            low = min(max(low, _LEAST_SAMPLES * problem.grid.spacing_s(made[j].blocks)), high)
        value = float(np.clip(np.exp(log), low, high))
        made[j] = dataclasses.replace(made[j], shape={**made[j].shape, key: value})
    return made


def _slopes(problem: FitProblem, fit: FitResult, free: list[tuple[int, str]]) -> Array:
    """Signatures of the free numbers' logarithms, shape (rows, free)."""
    logs = _numbers(fit.candidates, free)
    made = np.zeros((len(problem.rows), len(free)))
    for i in range(len(free)):
        ends = []
        for way in (-_STEP, _STEP):
            moved = logs.copy()
            moved[i] += way
            candidates = _with(problem, fit.candidates, free, moved)
            span = _numbers(candidates, free)[i]
            ends.append((problem.residual_at(fit.shift, candidates, fit.amounts), span))
        span = ends[1][1] - ends[0][1]
        if span > 0.0:
            # Residuals are measured less predicted; signatures are what a prediction gains.
            made[:, i] = (ends[0][0] - ends[1][0]) / span
    return made


def _moved(
    problem: FitProblem, fit: FitResult, beta: Array, free: list[tuple[int, str]]
) -> FitResult:
    n, amounts = len(fit.shift), len(fit.amounts)
    logs = _numbers(fit.candidates, free)
    logs = logs + np.clip(beta[n + amounts :], -_STRIDE, _STRIDE)
    candidates = _with(problem, fit.candidates, free, logs)
    return problem.at(fit.shift + beta[:n], candidates, fit.amounts + beta[n : n + amounts], fit)
