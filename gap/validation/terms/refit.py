"""The plant's constants fitted together with a term: where a gap has led them astray.

A gap that no constant can be blamed for still moves them, often by many standard deviations. There
a law is bent otherwise than at the true constants, and a term that is right looks wrong.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gap.estimation.config import ESTIMATION
from gap.estimation.fit_problem import FitProblem, FitResult
from gap.estimation.information import damped_step, tolerance
from gap.model.features import BLOCKS
from gap.validation.terms.pieces import FlowColumns
from plant.arrays import Array

_ROUNDS = 30
_FIRST_DAMPING = 1e-6
_ENOUGH = 1.0
"""Chi-square below which what a step gains is nothing, and the step the last one."""
_SMALL_STEPS = 2
"""Such steps in a row that end a fit although damping held them short. A matter of definition."""


@dataclass(frozen=True)
class TermColumns:
    """A term as it is fitted together with the constants.

    Attributes:
        columns: one row a feature of the problem, shape (rows, columns).
        penalty: prior of its coefficients, shape (columns, columns).
        flows: the last of the columns that are flows into the chamber: the simulated gas takes
            them in.
    """

    columns: Array
    penalty: Array
    flows: FlowColumns

    @property
    def plain(self) -> int:
        """Number of columns that are no flows."""
        return int(self.columns.shape[1]) - len(self.flows.scales)

    def residual(self, problem: FitProblem, fit: FitResult, beta: Array) -> Array:
        """What a fit leaves with the term."""
        made = fit.residual - self.columns[:, : self.plain] @ beta[: self.plain]
        if self.flows.scales:
            here = problem.rows.block == BLOCKS.index("pressure")
            made[here] += self._rows(problem, fit, beta) - fit.residual[here]
        return np.asarray(made)

    def slopes(self, problem: FitProblem, fit: FitResult, beta: Array) -> Array:
        """What each coefficient adds to the prediction there, shape (rows, columns)."""
        if not self.flows.scales:
            return self.columns
        made = self.columns.copy()
        here = problem.rows.block == BLOCKS.index("pressure")
        middle = self._rows(problem, fit, beta)
        for k in range(self.plain, len(beta)):
            step = _SLOPE_KPA / max(float(np.sqrt(np.mean(self.columns[here, k] ** 2))), 1e-9)
            moved = beta.copy()
            moved[k] += step
            made[here, k] = (middle - self._rows(problem, fit, moved)) / step
        return made

    def _rows(self, problem: FitProblem, fit: FitResult, beta: Array) -> Array:
        """Rows of the pressure with the flows."""
        active = problem.active_effects(fit.shift, fit.candidates, fit.amounts)
        flow = self.flows.flow(beta[self.plain :])
        rows = problem.model.pressure_with_flow(flow, problem.constants(fit.shift), active)
        return np.nan_to_num(rows, nan=0.0, posinf=3e3, neginf=-3e3)


_SLOPE_KPA = 0.05
"""Root mean square by which the pressure moves where a slope is taken."""


@dataclass(frozen=True)
class FittedTerm:
    """Constants and amounts that were fitted together with a term.

    Attributes:
        fit: without the term.
        left: what it leaves with the term, shape (rows,).
        beta: coefficients of the term.
    """

    fit: FitResult
    left: Array
    beta: Array
    cost: float


def fitted_with_term(
    problem: FitProblem, fit: FitResult, term: TermColumns, first: Array
) -> FittedTerm:
    """The constants and amounts of a fit, fitted anew together with a term (Marquardt 1963).

    Args:
        first: coefficients to begin with, where they are better than none, shape (columns,).
    """
    n, width = len(problem.names), len(problem.names) + len(fit.candidates)
    penalty = term.penalty
    beta = np.zeros(term.columns.shape[1])
    state = fit
    left = term.residual(problem, fit, beta)
    cost = _cost(problem, fit, left, penalty, beta)
    begun = term.residual(problem, fit, first)
    if _cost(problem, fit, begun, penalty, first) < cost:
        beta, left, cost = first, begun, _cost(problem, fit, begun, penalty, first)
    damping, small = _FIRST_DAMPING, 0
    matrix = right = None
    for _ in range(_ROUNDS):
        if matrix is None or right is None:
            whole = np.hstack([problem.columns_of(state), term.slopes(problem, state, beta)])
            matrix, right = problem.normal(whole, left, state.shift)
            matrix[width:, width:] += penalty
            right[width:] -= penalty @ beta
        step = damped_step(matrix, right, damping)
        trial = problem.at(
            state.shift + step[:n], state.candidates, state.amounts + step[n:width], fit
        )
        there = term.residual(problem, trial, beta + step[width:])
        reached = _cost(problem, trial, there, penalty, beta + step[width:])
        if not reached < cost:
            damping = max(damping, 1e-4) * 8.0
            continue
        gain = cost - reached
        state, cost, left, beta = trial, reached, there, beta + step[width:]
        matrix = right = None
        small = small + 1 if gain < _ENOUGH else 0
        if small and (damping < 1e-4 or small >= _SMALL_STEPS):
            break
        damping = max(damping / 10.0, 1e-9)
    return FittedTerm(state, left, beta, cost)


def within_walls(problem: FitProblem, fit: FitResult) -> FitResult:
    """The fit with no constant beyond its tolerance; itself where none is.

    Millions of readings move a constant as far as they like. What it does out there is part of the
    gap: a plant of which nobody states such a constant has not been recalibrated by it.
    """
    wall = ESTIMATION.tolerance_sd
    if np.abs(fit.shift).max(initial=0.0) <= wall + _GIVES_WAY_SD:
        return fit
    # Clipped constants no longer go together; those that are stated do.
    starts = (np.clip(fit.shift, -wall, wall), np.zeros_like(fit.shift))
    found = (_descended_within(problem, fit, start, wall) for start in starts)
    return min(found, key=lambda one: one.cost)


def _descended_within(problem: FitProblem, fit: FitResult, start: Array, wall: float) -> FitResult:
    """The least that is reached from `start` with every constant inside the walls."""
    n = len(problem.names)
    state = problem.at(start, fit.candidates, fit.amounts, fit)
    damping = _FIRST_DAMPING
    normal: tuple[Array, Array] | None = None
    for _ in range(_ROUNDS):
        if normal is None:
            normal = problem.normal(problem.columns_of(state), state.residual, state.shift)
        matrix, right = normal
        outwards = np.sign(right[:n]) * state.shift >= wall
        free = np.r_[~outwards, np.ones(len(state.amounts), dtype=bool)]
        step = np.zeros(len(free))
        step[free] = damped_step(matrix[np.ix_(free, free)], right[free], damping)
        there = np.clip(state.shift + step[:n], -wall, wall)
        trial = problem.at(there, state.candidates, state.amounts + step[n:], fit)
        if not trial.cost < state.cost:
            damping = max(damping, 1e-4) * 8.0
            continue
        gain, state, normal = state.cost - trial.cost, trial, None
        if gain < _ENOUGH and damping < 1e-4:
            break
        damping = max(damping / 10.0, 1e-9)
    return state


_GIVES_WAY_SD = 0.1
"""Sd by which a wall gives way to a constant that ordinary data push against it: its cost there is
1, that of chance (`ESTIMATION.beyond_weight`)."""


def _cost(problem: FitProblem, fit: FitResult, left: Array, penalty: Array, beta: Array) -> float:
    """Whitened sum of squares of what is left, priors of constants and coefficients included."""
    return problem.whitened(left) + tolerance(fit.shift)[0] + float(beta @ penalty @ beta)
