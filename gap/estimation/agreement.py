"""Agreement of replicates: on an amount, and on what a fit leaves.

An effect does the same to all replicates of a slot. What differs between them is noise, whatever
its size and law. So both tests need no model of the noise.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
import numpy.typing as npt

from gap.estimation.config import ESTIMATION
from gap.estimation.fit_problem import FitProblem
from gap.estimation.information import gather
from plant.arrays import Array


def replicate_inflation(problem: FitProblem, key: str) -> float:
    """Factor by which replicates differ more in the amount of `key` than the noise model predicts.

    Of the best candidate of that key, linearised at the recalibrated plant. Each trial has an
    amount of its own. The factor is the spread within slots over the spread expected, each trial
    with its weight in the amount. The model counts as much as a few replicates.

    Returns:
        Factor of variance, at least 1.
    """
    columns = problem.signatures(problem.base)
    n = len(problem.names)
    own = [n + 1 + j for j, candidate in enumerate(problem.candidates) if candidate.key == key]
    trials = np.arange(len(problem.noise.trial_rows))
    evidence = gather(
        problem.noise,
        columns[:, :n],
        problem.base.residual,
        columns[:, own],
        problem.rows.block,
        problem.rows.compared_s,
        trials,
        problem.base.shift,
    )
    total = evidence.total
    inner = total[:n, :n] + np.diag(evidence.stiffness)
    best = (-np.inf, 1.0)
    for at in range(n + 1, n + 1 + len(own)):
        taken = np.linalg.solve(inner, total[:n, at]) if n else np.empty(0)
        pull = evidence.gram[:, at, n] - evidence.gram[:, :n, n] @ taken
        size = evidence.gram[:, at, at] - 2.0 * evidence.gram[:, :n, at] @ taken
        size = size + np.einsum("tij,i,j->t", evidence.gram[:, :n, :n], taken, taken)
        gain = float(pull.sum() ** 2 / max(size.sum(), 1e-12))
        if gain > best[0]:
            best = (gain, _spread(problem.units, pull, np.maximum(size, 0.0)))
    return best[1]


def _spread(units: npt.NDArray[np.int64], pull: Array, size: Array) -> float:
    """Spread of the pulls within units over the one expected, shrunk towards one."""
    found, expected = 0.0, []
    for unit in np.unique(units).tolist():
        at = np.flatnonzero((units == unit) & (size > 1e-9 * size.max(initial=0.0)))
        if len(at) < 2:
            continue
        amount = pull[at].sum() / size[at].sum()
        found += float(np.sum((pull[at] - size[at] * amount) ** 2))
        expected += (size[at] * (1.0 - size[at] / size[at].sum())).tolist()
    weights = np.array(expected)
    if not weights.sum():
        return 1.0
    freedom = float(weights.sum() ** 2 / np.sum(weights**2))
    ratio = found / float(weights.sum())
    weight = ESTIMATION.agreement_weight
    return max(1.0, (freedom * ratio + weight) / (freedom + weight))


def shared_chi2(problem: FitProblem, residual: Array) -> float:
    """What replicates share of a residual, as whitened squares; that of noise is zero on average.

    Products of different replicates of a slot over the features both have, for each trial the mean
    over its partners.

    Args:
        residual: shape (rows,).
    """
    total = 0.0
    for members in problem.data.slots.values():
        if len(members) < 2:
            continue
        parts = [_by_bin(problem, trial, residual) for trial in members]
        products = []
        for a, b in combinations(parts, 2):
            common = a.keys() & b.keys()
            products.append(sum(a[bin_] * b[bin_] for bin_ in common))
        total += float(np.mean(products)) * len(members)
    return total


def _by_bin(problem: FitProblem, trial: int, residual: Array) -> dict[tuple[int, int], float]:
    rows = problem.noise.trial_rows[trial]
    if not len(rows):
        return {}
    white = problem.noise.whiten(trial, residual[rows][:, None])[:, 0]
    places = zip(problem.rows.block[rows].tolist(), problem.rows.bin[rows].tolist(), strict=True)
    return dict(zip(places, white.tolist(), strict=True))
