"""Per-stroke delays: a valve whose delay is not the same at each stroke.

A poppet that sticks, or a coil whose iron keeps some field, is later at one stroke than at the
next, alike in all replicates. Where a delay explains the gap, what such differences leave is
evidence neither against the delay nor for an effect from outside the catalogue.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gap.estimation.fit_problem import FitProblem, FitResult
from gap.estimation.information import damped_step, tolerance
from gap.selection.config import SELECTION, SelectionConfig
from gap.selection.inclusion import excess_chi2
from gap.selection.search import SearchResult
from plant.arrays import Array
from plant.effects.catalogue import CATALOGUE

_STEP_S = 1e-4


def with_per_stroke_delays(
    problem: FitProblem, search: SearchResult, config: SelectionConfig = SELECTION
) -> SearchResult:
    """The outcome of a search with the strokes of a delay that it found free to differ."""
    per_stroke = _per_stroke_fit(problem, search.best.fit, config)
    if per_stroke is None:
        return search
    return replace(
        search, left=min(search.left, excess_chi2(problem, per_stroke)), per_stroke=per_stroke
    )


def _per_stroke_fit(
    problem: FitProblem, fit: FitResult, config: SelectionConfig
) -> FitResult | None:
    """The fit one linear step on, its delays free to differ at each stroke.

    None without a delay, or where its strokes would have to differ too much.
    Constants and amounts move as well: strokes that are late by more had bent them.
    """
    if problem.data.constants.valve == "proportional":  # its strokes run into one another
        return None
    columns, sds = [], []
    for candidate, amount in zip(fit.candidates, fit.amounts.tolist(), strict=True):
        effect = CATALOGUE.get(candidate.id)
        if effect is None or effect.diagnosis.late is None:
            continue
        late = effect.diagnosis.late(amount, problem.data.constants)
        own = _strokes(problem, fit, effect.options.index(candidate.option))
        columns.append(own)
        sds += [max(config.stroke_sd * late, 1e-9)] * own.shape[1]
    if not sds:
        return None
    known = problem.columns_of(fit)
    every = np.hstack([known, *columns])
    matrix, right = problem.normal(every, fit.residual, fit.shift)
    last = np.arange(known.shape[1], every.shape[1])
    matrix[last, last] += 1.0 / np.square(sds)
    beta = damped_step(matrix, right, 1e-6)
    if np.abs(beta[last] / sds).max() > config.stroke_most_sd:
        return None
    n, m = len(fit.shift), len(fit.amounts)
    residual = fit.residual - every @ beta
    return replace(
        fit, shift=fit.shift + beta[:n], amounts=fit.amounts + beta[n : n + m],
        residual=residual, cost=problem.whitened(residual) + tolerance(fit.shift + beta[:n])[0],
    )  # fmt: skip


def _strokes(problem: FitProblem, fit: FitResult, edge: int) -> Array:
    """Signatures of a delay, s, at each stroke alone, shape (rows, strokes).

    Replicates of a slot share a stroke; `edge` counts inlet on, inlet off, outlet on, outlet off.
    """
    grid = problem.grid
    valve, value = divmod(edge, 2)
    of = (grid.edge_of == valve) & ((grid.edge_to > 0.5) == (value == 0))
    trial = np.repeat(np.arange(len(grid.first_edge) - 1), np.diff(grid.first_edge))
    number = np.full(len(of), -1)
    for t in np.unique(trial[of]).tolist():
        own = np.flatnonzero(of & (trial == t))
        number[own] = np.arange(len(own))
    c, active = (
        problem.constants(fit.shift),
        problem.active_effects(fit.shift, fit.candidates, fit.amounts),
    )
    unit = problem.units[problem.rows.trial]
    made = []
    for stroke in range(int(number.max(initial=-1)) + 1):
        ends = []
        for way in (-_STEP_S, _STEP_S):
            moved = replace(grid, edge_s=grid.edge_s + np.where(number == stroke, way, 0.0))
            model = replace(problem.model, grid=moved)
            ends.append(model.stacked(model.residual(c, active, ("pressure",))))
        late = (ends[0] - ends[1]) / (2.0 * _STEP_S)
        for slot in np.unique(unit[late != 0.0]).tolist():
            made.append(np.where(unit == slot, late, 0.0))
    return np.nan_to_num(np.stack(made, axis=1)) if made else np.zeros((len(problem.rows), 0))
