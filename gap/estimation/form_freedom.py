"""What freer forms of effects would take: whether another effect only corrects an inexact form.

No form of the diagnosis is that of a bench. What an inexact form leaves looks like one more effect,
in the channels of the first. So each effect is compared with a free form of the others: what each
of them adds to the prediction, multiplied by a smooth function of the inputs of the stage. A free
form may deviate by `EstimationConfig.form_freedom` (1 sd, of what the effect adds).

Everything is linearised at the fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gap.estimation.config import ESTIMATION
from gap.estimation.fit_problem import FitProblem, FitResult
from gap.model.empirical import inputs_of
from gap.model.features import BLOCKS
from plant.arrays import Array

Whole = npt.NDArray[np.int64]

_EDGE_S = 0.03
"""Seconds after an edge that part its course in two: valves take ten milliseconds, gas more."""


@dataclass(frozen=True)
class FormFreedom:
    """What free forms do to an explanation, in chi-square.

    Attributes:
        instead: by effect, what free forms of the others take in its place, as a share of what it
            takes itself; 0 where it is the only effect.
        taken: what free forms of all effects take of what the explanation leaves.
    """

    instead: dict[str, float]
    taken: float


def form_freedom(problem: FitProblem, fit: FitResult) -> FormFreedom:
    """Free forms of the effects of a fit, in the place of each other and beside them."""
    ids = fit.ids
    n = len(problem.names)
    columns = problem.columns_of(fit)
    width = columns.shape[1]
    own = {name: [n + j for j, c in enumerate(fit.candidates) if c.id == name] for name in ids}
    added = np.stack([_added(problem, fit, name) for name in ids], axis=1)
    bases = _bases(problem)
    free = np.hstack([added[:, [k]] * bases for k in range(len(ids))])
    used = np.flatnonzero(np.any(free != 0.0, axis=0))
    of_free = np.repeat(np.arange(len(ids)), bases.shape[1])[used]
    free = free[:, used]
    matrix, right = problem.normal(np.hstack([columns, free, added]), fit.residual, fit.shift)
    end = width + free.shape[1]
    matrix[range(width, end), range(width, end)] += ESTIMATION.form_freedom**-2

    def gain(at: Whole, right: Array) -> float:
        """Fall of chi-square by the columns `at`."""
        unit = np.sqrt(np.maximum(np.diag(matrix)[at], 1e-300))
        inner = matrix[np.ix_(at, at)] / unit / unit[:, None] + 1e-10 * np.eye(len(at))
        return float(right[at] / unit @ np.linalg.solve(inner, right[at] / unit))

    whole, forms = np.arange(width), np.arange(width, end)
    taken = gain(np.r_[whole, forms], right) - gain(whole, right)
    instead = {}
    for k, name in enumerate(ids):
        less = np.array([j for j in whole.tolist() if j not in own[name]], dtype=np.int64)
        others = forms[of_free != k]
        # Without the effect, what it has added is left to explain.
        left = right + matrix[:, end + k]
        without = gain(less, left)
        lost = gain(whole, left) - without
        instead[name] = (gain(np.r_[less, others], left) - without) / max(lost, 1e-9)
    return FormFreedom(instead, max(taken, 0.0))


def _added(problem: FitProblem, fit: FitResult, name: str) -> Array:
    """What an effect adds to the prediction of a fit, shape (rows,)."""
    amounts = np.array(
        [0.0 if c.id == name else a for c, a in zip(fit.candidates, fit.amounts, strict=True)]
    )
    return problem.residual_at(fit.shift, fit.candidates, amounts) - fit.residual


def _bases(problem: FitProblem) -> Array:
    """Smooth functions of the inputs of each stage, from -1 to 1; shape (rows, functions).

    Those of one block are zero in the others.
    """
    made: list[Array] = []
    for block in problem.grid.points:
        here = np.flatnonzero(problem.rows.block == BLOCKS.index(block))
        if block == "pressure":
            at = inputs_of(problem.grid, block, ("pressure_kpa", "since_edge_s", "valve"))
            p, valve = _spread(at["pressure_kpa"]), at["valve"]
            early = 2.0 / (1.0 + at["since_edge_s"] / _EDGE_S) - 1.0
            own: Sequence[Array] = (p, early, valve, p * valve, early * valve, p * p, p * early)
        else:
            at = inputs_of(problem.grid, block, ("pressure_kpa", "length_mm", "time_s", "slip"))
            p, x, t = (_spread(at[k]) for k in ("pressure_kpa", "length_mm", "time_s"))
            own = (p, x, t, p * p, p * x, x * x, at["slip"])
        for values in own:
            column = np.zeros(len(problem.rows))
            column[here] = values
            made.append(column)
    return np.stack(made, axis=1)


def _spread(values: Array) -> Array:
    """Values mapped to -1 to 1 over their range; zero where they do not vary."""
    low, high = float(values.min()), float(values.max())
    if high - low < 1e-9:
        return np.zeros(len(values))
    return np.asarray(2.0 * (values - low) / (high - low) - 1.0)
