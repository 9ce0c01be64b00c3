"""The plant's constants fitted together with a term: where a gap has led them astray.

A gap that no constant can be blamed for still moves them, often by many standard deviations. There
a law is bent otherwise than at the true constants, and a term that is right looks wrong.
"""

from __future__ import annotations

import numpy as np

from gap.estimation.fit_problem import FitProblem, FitResult
from gap.estimation.information import damped_step, tolerance
from plant.arrays import Array

_ROUNDS = 30
_FIRST_DAMPING = 1e-6
_ENOUGH = 1e-3
"""Share of the cost below which a step is the last one."""


def fitted_with_term(
    problem: FitProblem, fit: FitResult, columns: Array, penalty: Array
) -> tuple[FitResult, float]:
    """The constants and amounts of a fit, fitted anew together with a term (Marquardt 1963).

    Args:
        columns: of the term, one row a feature of the problem, shape (rows, columns).
        penalty: prior of its coefficients, shape (columns, columns).

    Returns:
        The fit without the term, whose residual holds it; and the cost with the term.
    """
    n, width = len(problem.names), len(problem.names) + len(fit.candidates)
    beta = np.zeros(columns.shape[1])
    state, cost = fit, _cost(problem, fit, columns, penalty, beta)
    damping = _FIRST_DAMPING
    matrix = right = None
    for _ in range(_ROUNDS):
        if matrix is None or right is None:
            whole = np.hstack([problem.columns_of(state), columns])
            matrix, right = problem.normal(whole, state.residual - columns @ beta, state.shift)
            matrix[width:, width:] += penalty
            right[width:] -= penalty @ beta
        step = damped_step(matrix, right, damping)
        trial = problem.at(
            state.shift + step[:n], state.candidates, state.amounts + step[n:width], fit
        )
        there = _cost(problem, trial, columns, penalty, beta + step[width:])
        if not there < cost:
            damping = max(damping, 1e-4) * 8.0
            continue
        gain = cost - there
        state, cost, beta = trial, there, beta + step[width:]
        matrix = right = None
        if gain < _ENOUGH * cost and damping < 1e-4:
            break
        damping = max(damping / 10.0, 1e-9)
    return state, cost


def _cost(
    problem: FitProblem, fit: FitResult, columns: Array, penalty: Array, beta: Array
) -> float:
    """Whitened sum of squares with a term, the priors of constants and coefficients included."""
    left = problem.whitened(fit.residual - columns @ beta)
    return left + tolerance(fit.shift)[0] + float(beta @ penalty @ beta)
