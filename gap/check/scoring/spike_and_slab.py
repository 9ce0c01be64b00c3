"""One posterior over effects, constants and model discrepancy: what a textbook would use instead.

A linear model of what the recalibrated plant leaves, with the noise of the replicates: constants
with their tolerances as prior, a few effects (George and McCulloch, J. Am. Stat. Assoc. 88 (1993)
881) of unknown size, an error of form for each, and a discrepancy that is a Gaussian process of
pressure, length and time in every channel (Kennedy and O'Hagan, J. R. Stat. Soc. B 63 (2001) 425).
Everything but which effects act and two scales is integrated in closed form.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from gap.estimation.fit_problem import FitProblem
from plant.arrays import Array
from plant.effects.catalogue import CATALOGUE

EFFECTS = 12
"""Effects that are considered, those first that alone explain most."""
TOGETHER = 3
"""Effects of which all combinations are considered; more are added one by one."""
MOST = 6
SIZES = (1.0, 16.0, 256.0)
"""Prior variances of an effect: what it adds to a reading, in units of the noise."""
DISCREPANCIES = (0.0, 1.0, 4.0, 16.0)
"""Prior sd of the discrepancy, in units of the noise. Zero: the model is exact."""
FORM = 0.2
"""Prior sd of the error of an effect's form, in units of the effect."""
WAVES = 8
"""Cosines (Rahimi and Recht 2007) that carry a Gaussian process in each channel."""
PRIOR_ODDS = 1.0 / 30.0
"""Prior odds of each effect."""
NAMED = 0.7
"""Least probability of a set of effects that is named."""


@dataclass(frozen=True)
class LinearModel:
    """Inner products of all columns, whitened: [constants | discrepancy | each effect's own].

    Attributes:
        gram: shape (columns, columns), the constants' prior included.
        right: inner products with the residual, shape (columns,).
        constants: number of columns of the constants.
        waves: number of columns of the discrepancy.
        names: id of each effect; its columns are itself and itself times each wave.
        size: prior sd of an amount that adds one unit of noise to a reading, shape (effects,).
    """

    gram: Array
    right: Array
    constants: int
    waves: int
    names: tuple[str, ...]
    size: Array

    def own(self, effect: int) -> list[int]:
        """Columns of an effect: the effect, then what its form may be off by."""
        first = self.constants + self.waves + effect * (1 + WAVES)
        return list(range(first, first + 1 + WAVES))

    def evidence(self, effects: Sequence[int], discrepancy: float, size: float) -> float:
        """Logarithm of the marginal likelihood, up to a constant of the data."""
        fixed = list(range(self.constants))
        waves = list(range(self.constants, self.constants + self.waves)) if discrepancy else []
        alone = [self.own(j)[0] for j in effects]
        sd = self.size[list(effects)] * np.sqrt(size)
        prior = np.r_[np.full(len(waves), discrepancy or 1.0) ** -2, sd**-2]
        amount = self._posterior([*fixed, *waves, *alone], prior)[1][len(fixed) + len(waves) :]
        # An error of form is in proportion to the effect.
        off = [column for j in effects for column in self.own(j)[1:]]
        scale = np.repeat(np.maximum(np.abs(amount), 1e-3 * sd), WAVES) * FORM
        return self._posterior([*fixed, *waves, *alone, *off], np.r_[prior, scale**-2])[0]

    def _posterior(self, columns: list[int], prior: Array) -> tuple[float, Array]:
        """Log evidence and posterior mean; `prior` has the precisions beyond the constants."""
        matrix = self.gram[np.ix_(columns, columns)].copy()
        precision = np.r_[np.ones(self.constants), prior]
        at = range(self.constants, len(columns))
        matrix[at, at] += prior
        unit = np.sqrt(np.diag(matrix))
        even = matrix / unit / unit[:, None] + 1e-10 * np.eye(len(unit))
        solved = np.linalg.solve(even, self.right[columns] / unit)
        size = float(np.linalg.slogdet(even)[1] + 2.0 * np.log(unit).sum())
        gained = float(solved @ (self.right[columns] / unit))
        return 0.5 * (gained - size + float(np.log(precision).sum())), np.asarray(solved / unit)


def linear_model(problem: FitProblem) -> LinearModel:
    """The linear model at the recalibrated plant, with the effects that alone explain most."""
    base = problem.base
    columns = problem.signatures(base)
    n = len(problem.names)
    usable = [(j, s.id) for j, s in enumerate(problem.candidates) if not s.defect]
    waves = _waves(problem)
    rows = problem.rows
    noise = np.sqrt(np.maximum(problem.noise.white, 1e-12))
    in_block = (rows.block[:, None] == np.unique(rows.block)) * noise[:, None]
    discrepancy = (in_block[:, :, None] * waves[:, None, :]).reshape(len(waves), -1)
    own = columns[:, [n + 1 + j for j, _ in usable]]
    gram, right = problem.normal(np.hstack([columns[:, :n], own]), base.residual, base.shift)
    taken = np.linalg.solve(gram[:n, :n], gram[:n, n:])
    pull = right[n:] - taken.T @ right[:n]
    left = np.diag(gram)[n:] - np.einsum("ij,ij->j", gram[:n, n:], taken)
    gain = pull**2 / np.maximum(left, 1e-9 * np.maximum(np.diag(gram)[n:], 1e-30))
    best: dict[str, int] = {}
    for at in np.argsort(-gain).tolist():
        best.setdefault(usable[at][1], at)
    chosen = list(best.items())[:EFFECTS]
    made = [own[:, [at]] * np.hstack([np.ones((len(waves), 1)), waves]) for _, at in chosen]
    whole = np.hstack([columns[:, :n], discrepancy, *made])
    gram, right = problem.normal(whole, base.residual, base.shift)
    size = [np.sqrt(len(rows) / max(np.sum((own[:, at] / noise) ** 2), 1e-30)) for _, at in chosen]
    names = tuple(name for name, _ in chosen)
    return LinearModel(gram, right, n, discrepancy.shape[1], names, np.array(size))


def _waves(problem: FitProblem) -> Array:
    """Waves over pressure, length and time that make a Gaussian process, shape (rows, WAVES)."""
    rows = problem.rows
    inputs = [rows.pressure, rows.length, np.log1p(rows.time_s)]
    spread = [
        2.0 * (x - np.nanmin(x)) / max(float(np.nanmax(x) - np.nanmin(x)), 1e-12) for x in inputs
    ]
    rng = np.random.default_rng(1)
    turn, phase = rng.standard_normal((3, WAVES)), rng.uniform(0.0, 2.0 * np.pi, WAVES)
    phases = np.nan_to_num(np.stack(spread, axis=1)) @ turn + phase
    return np.asarray(np.sqrt(2.0 / WAVES) * np.cos(phases))


def posterior(model: LinearModel) -> dict[tuple[str, ...], tuple[float, float]]:
    """Probability of each set of effects, without a discrepancy and with one; all add up to 1."""
    count = len(model.names)
    sets: dict[frozenset[int], Array] = {}

    def consider(one: frozenset[int]) -> float:
        if one not in sets:
            prior = len(one) * np.log(PRIOR_ODDS)
            logs = [[prior + model.evidence(sorted(one), d, g) for g in (SIZES if one else (1.0,))]
                    for d in DISCREPANCIES]  # fmt: skip
            sets[one] = np.array([np.logaddexp.reduce(row) - np.log(len(row)) for row in logs])
        return float(np.logaddexp.reduce(sets[one]))

    for many in range(TOGETHER + 1):
        for one in combinations(range(count), many):
            consider(frozenset(one))
    best = max(sets, key=consider)
    while len(best) < min(MOST, count):
        wider = max((best | {j} for j in range(count) if j not in best), key=consider)
        if consider(wider) <= consider(best):
            break
        best = wider
    whole = np.logaddexp.reduce([np.logaddexp.reduce(logs) for logs in sets.values()])
    return {
        tuple(model.names[j] for j in sorted(one)): (
            float(np.exp(logs[0] - whole)),
            float(np.exp(np.logaddexp.reduce(logs[1:]) - whole)),
        )
        for one, logs in sets.items()
    }


def by_posterior(problem: FitProblem) -> dict[str, Any]:
    """The posterior's verdict in the exchange form."""
    found = posterior(linear_model(problem))
    none, unknown = found.pop(())
    ranked = sorted(((sum(p), ids) for ids, p in found.items()), reverse=True)
    effects: list[dict[str, Any]] = [
        {"ids": list(ids), "family": CATALOGUE[ids[0]].family, "probability": p, "parameters": {}}
        for p, ids in ranked[:10]
        if p >= 0.01
    ]
    first = max((p for p, _ in ranked), default=0.0)
    if max(none, unknown) >= first:
        status = "no_gap_above_floor" if none >= unknown else "unknown"
    else:
        status = "named" if first >= NAMED else "indistinguishable"
    explained = status in ("named", "indistinguishable")
    return {
        "status": status,
        "stage": CATALOGUE[ranked[0][1][0]].stage if explained else None,
        "effects": effects,
        "probability_none": none,
        "probability_unknown": unknown,
    }
