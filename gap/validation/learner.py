"""A generic learner of the residual: what closes the gap without naming anything.

Ridge regression of each block's recalibrated residual on splines of the block's inputs, learnt and
tested on the same held-out units as the named effects. With no more degrees of freedom than the
named effects have parameters it is what naming is worth; with a hundred it is the ceiling: what
these inputs could explain at all. The difference is what is still unexplained.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.interpolate import BSpline

from gap.estimation.cross_validation import left_out
from gap.estimation.fit_problem import FitProblem
from gap.model.features import BLOCKS
from gap.validation.where import pressure_rise
from plant.arrays import Array

_KNOTS = 6
_CROSS = 4
_INNER = 5
_PENALTIES = 10.0 ** np.arange(-4.0, 5.0, 1.0)


@dataclass(frozen=True)
class Learnt:
    """Squared errors on held-out units, by block, shape (units,) each.

    Attributes:
        alike: learner with as many degrees of freedom as the named effects have amounts.
        large: the large one, its penalty chosen inside each fold.
        inputs: splines of the large one, by block.
    """

    alike: dict[str, Array]
    large: dict[str, Array]
    inputs: dict[str, int]


def generic(problem: FitProblem, freedom: int) -> Learnt:
    """Learn the residual of every block without a name; units are slots."""
    units = problem.units
    fold = left_out(problem, problem.base, units).change
    alike: dict[str, Array] = {}
    large: dict[str, Array] = {}
    sizes: dict[str, int] = {}
    for number, block in enumerate(BLOCKS):
        at = np.flatnonzero(problem.rows.block == number)
        if not len(at):
            continue
        basis = _basis(problem, block, at)
        sizes[block] = basis.shape[1]
        table = _Table(
            basis,
            problem.base.residual[at],
            problem.columns[at],
            problem.rows.compared_s[at],
            units[problem.rows.trial[at]],
            fold,
        )
        alike[block] = table.with_freedom(max(freedom, 1))
        large[block] = table.with_best_penalty()
    return Learnt(alike, large, sizes)


class _Table:
    """Inner products of one block's basis by unit, and ridge fits to all units but one."""

    def __init__(
        self, basis: Array, residual: Array, constants: Array, span: Array,
        unit: npt.NDArray[np.int64], fold: Array,
    ) -> None:  # fmt: skip
        self.basis, self.span, self.unit = basis, span, unit
        self.count = len(fold)
        weighted = basis * span[:, None]
        width = basis.shape[1]
        self.gram = np.zeros((self.count, width, width))
        self.right = np.zeros((self.count, width))
        self.across = np.zeros((self.count, width, constants.shape[1]))
        for u in np.unique(unit):
            own = unit == u
            self.gram[u] = basis[own].T @ weighted[own]
            self.right[u] = weighted[own].T @ residual[own]
            self.across[u] = weighted[own].T @ constants[own]
        self.residual, self.constants, self.fold = residual, constants, fold

    def _left(self, unit: int, keep: Array, penalty: float) -> Array:
        """Coefficients fitted to the units of `keep`; the base is the one of fold `unit`."""
        gram = np.tensordot(keep, self.gram, axes=1)
        right = keep @ (self.right - self.across @ self.fold[unit])
        ridge = penalty * np.trace(gram) / max(len(gram), 1)
        return np.asarray(np.linalg.solve(gram + (ridge + 1e-12) * np.eye(len(gram)), right))

    def _error(self, unit: int, base: int, coefficients: Array) -> float:
        """Squared error on a unit of the fold `base` with the basis added."""
        own = self.unit == unit
        rest = self.residual[own] - self.constants[own] @ self.fold[base]
        rest = rest - self.basis[own] @ coefficients
        return float(self.span[own] @ rest**2)

    def with_freedom(self, freedom: int) -> Array:
        """Errors with the penalty that leaves `freedom` effective degrees of freedom."""
        made = np.zeros(self.count)
        sizes = np.linalg.eigvalsh(self.gram.sum(axis=0))
        scale = max(float(sizes.mean()), 1e-30)
        grid = 10.0 ** np.linspace(-8.0, 8.0, 400)
        used = np.array([float(np.sum(sizes / (sizes + g * scale))) for g in grid])
        penalty = float(grid[int(np.argmin(np.abs(used - freedom)))])
        for unit in np.unique(self.unit):
            keep = np.ones(self.count)
            keep[unit] = 0.0
            made[unit] = self._error(int(unit), int(unit), self._left(int(unit), keep, penalty))
        return made

    def with_best_penalty(self) -> Array:
        """Errors with the penalty that does best inside each fold, on its own held-out parts."""
        made = np.zeros(self.count)
        present = np.unique(self.unit)
        for unit in present:
            others = present[present != unit]
            parts = np.arange(len(others)) % min(_INNER, max(len(others), 1))
            scores = np.zeros(len(_PENALTIES))
            for part in np.unique(parts):
                keep = np.zeros(self.count)
                keep[others[parts != part]] = 1.0
                if not keep.any():
                    continue
                for k, penalty in enumerate(_PENALTIES):
                    coefficients = self._left(int(unit), keep, float(penalty))
                    scores[k] += sum(
                        self._error(int(u), int(unit), coefficients) for u in others[parts == part]
                    )
            keep = np.zeros(self.count)
            keep[others] = 1.0
            best = float(_PENALTIES[int(np.argmin(scores))])
            made[unit] = self._error(int(unit), int(unit), self._left(int(unit), keep, best))
        return made


def _basis(problem: FitProblem, block: str, at: npt.NDArray[np.int64]) -> Array:
    """Splines of every input of the block, and products of pressure and length splines."""
    rows = problem.rows
    points = problem.grid.points[block]
    order = problem.model.order[rows.trial[at]]
    inputs = {
        "pressure": rows.pressure[at],
        "length": rows.length[at],
        "rate": np.arcsinh(rows.rate[at] / 1e-3),
        "rise": np.arcsinh(pressure_rise(problem)[at] / 1e4),
        "temperature": np.nan_to_num(problem.model._features(points, points.temperature), nan=21.0),
        "time": np.log1p(np.maximum(rows.time_s[at], 0.0)),
        "order": order,
        "direction": problem.model._features(points, points.direction),
    }
    if block == "pressure":
        inputs["since an edge"] = np.log10(_since_edge(problem, at) + 1e-3)
    made = [np.ones((len(at), 1))]
    made += [splines(x, _KNOTS) for x in inputs.values() if np.ptp(x) > 1e-9]
    if np.ptp(inputs["pressure"]) > 1e-9 and np.ptp(inputs["length"]) > 1e-9:
        p, length = (splines(inputs[name], _CROSS) for name in ("pressure", "length"))
        made.append((p[:, :, None] * length[:, None, :]).reshape(len(at), -1))
    return np.hstack(made)


def splines(x: Array, count: int) -> Array:
    """Cubic B-splines of x over its range, knots at its quantiles, shape (n, count or fewer)."""
    inner = np.unique(np.quantile(x, np.linspace(0.0, 1.0, max(count - 2, 2))))
    if len(inner) < 3:
        return np.asarray((x - x.mean())[:, None] / max(float(x.std()), 1e-30))
    knots = np.r_[[inner[0]] * 3, inner, [inner[-1]] * 3]
    return np.asarray(BSpline.design_matrix(np.clip(x, inner[0], inner[-1]), knots, 3).toarray())


def _since_edge(problem: FitProblem, at: npt.NDArray[np.int64]) -> Array:
    """Seconds since the last command's edge, ten where there was none."""
    made = np.full(len(at), 10.0)
    trials = problem.rows.trial[at]
    for t in np.unique(trials):
        edges = problem.grid.edge_s[problem.grid.first_edge[t] : problem.grid.first_edge[t + 1]]
        if not len(edges):
            continue
        own = trials == t
        time_s = problem.rows.time_s[at][own]
        last = np.searchsorted(edges, time_s) - 1
        since = np.where(last >= 0, time_s - edges[np.maximum(last, 0)], 10.0)
        made[own] = np.clip(since, 0.0, 10.0)
    return made
