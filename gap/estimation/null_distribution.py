"""The null distribution: gains of the best candidate on simulated data without a gap.

Each draw is a data set with noise only, projected on the candidates as the search does. The size of
the noise is uncertain too: zeros and gains of sensors are drawn once a trial, and few replicates
say little about their spread. So each draw first draws the size of each kind of noise, given the
replicates. A chi-square table knows neither this nor the number of candidates.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gap.estimation.config import ESTIMATION
from gap.estimation.fit_problem import FitProblem
from gap.estimation.information import Evidence
from plant.arrays import Array

DRAWS = 1000


@dataclass(frozen=True)
class Null:
    """Best gains of data sets without a gap, ascending, shape (draws,)."""

    best: Array

    def threshold(self, rate: float) -> float:
        """Gain that chance reaches in `rate` of such data sets."""
        return float(np.quantile(self.best, 1.0 - rate))

    def chance(self, gain: float) -> float:
        """Share of such data sets with a best gain of at least `gain`, never quite zero."""
        over = len(self.best) - int(np.searchsorted(self.best, gain))
        return (over + 1.0) / (len(self.best) + 1.0)


def simulated_null(problem: FitProblem) -> Null:
    """Null of the search's first step; with one seed, the same verdict from call to call."""
    rng = np.random.default_rng(1)
    evidence = problem.evidence(problem.base)
    columns = problem.signatures(problem.base)
    n = evidence.constants
    rest = [*range(n), *range(n + 1, columns.shape[1])]
    kinds: list[str] = []
    loads: list[Array] = []
    for trial, rows in enumerate(problem.noise.trial_rows):
        if not len(rows):
            continue
        a = problem.noise.whiten(trial, columns[np.ix_(rows, rest)])
        sd = np.array([problem.noise.scales[kind] for kind in problem.noise.kinds[trial]])
        b = problem.noise.whiten(trial, problem.noise.columns[trial] * sd[None, :])
        loads.append(b.T @ a)
        kinds += problem.noise.kinds[trial]
    whole = evidence.total[np.ix_(rest, rest)]
    # Columns come in units of their own, twelve decades apart.
    unit = 1.0 / np.sqrt(np.maximum(np.diag(whole), 1e-300))
    unit[np.diag(whole) <= 0.0] = 0.0
    load = np.vstack(loads) * unit
    whole = whole * unit * unit[:, None]
    size, turn = np.linalg.eigh(whole - load.T @ load)
    root = turn * np.sqrt(np.maximum(size, 0.0))
    known = ESTIMATION.prior_weight + problem.noise.freedom
    names = sorted(set(kinds))
    at = np.array([names.index(kind) for kind in kinds], dtype=np.int64)
    scale = np.sqrt(known / rng.chisquare(known, (DRAWS, len(names))))
    draws = (rng.standard_normal((DRAWS, len(at))) * scale[:, at]) @ load
    draws += rng.standard_normal((DRAWS, len(root))) @ root.T
    prior = np.diag(np.where(unit[:n] > 0.0, evidence.stiffness * unit[:n] ** 2, 1.0))
    lever = np.linalg.solve(whole[:n, :n] + prior, whole[:n, n:])
    # The constants' own errors, drawn from their tolerances, pull on the fit as well.
    own = rng.standard_normal((DRAWS, n)) * np.sqrt(np.diag(prior))
    left = draws[:, n:] - (draws[:, :n] + own) @ lever
    norm = np.diag(whole)[n:] - np.einsum("ij,ij->j", whole[:n, n:], lever)
    positive = np.array([s.sign > 0 for s in problem.candidates])
    gains = np.where(positive & (left < 0.0), 0.0, left**2 / np.maximum(norm, 1e-9))
    gains[:, norm < 1e-7] = 0.0
    return Null(np.sort(gains.max(axis=1, initial=0.0)))


RESIDUALS = 500


def simulated_residuals(problem: FitProblem, draws: int = RESIDUALS) -> Array:
    """Recalibrated residuals of data sets without a gap, shape (rows, draws); one seed.

    As in `simulated_null`: noise of uncertain size, and constants with errors of their own, then
    the constants fitted.
    """
    rng = np.random.default_rng(2)
    noise, columns = problem.noise, problem.columns
    known = ESTIMATION.prior_weight + noise.freedom
    size = {kind: np.sqrt(known / rng.chisquare(known, draws)) for kind in sorted(noise.scales)}
    made = np.sqrt(noise.white)[:, None] * rng.standard_normal((len(noise.white), draws))
    n = columns.shape[1]
    right = np.zeros((n, draws))
    inner = np.eye(n)
    own = rng.standard_normal((n, draws))
    for trial, rows in enumerate(noise.trial_rows):
        if not len(rows):
            continue
        sd = np.array([noise.scales[kind] * size[kind] for kind in noise.kinds[trial]])
        made[rows] += noise.columns[trial] @ (sd * rng.standard_normal(sd.shape))
        made[rows] += columns[rows] @ own
        a, b = noise.whiten(trial, columns[rows]), noise.whiten(trial, made[rows])
        inner += a.T @ a
        right += a.T @ b
    scale = np.sqrt(np.diag(inner))
    lever = np.linalg.solve(inner / scale / scale[:, None], right / scale[:, None])
    return np.asarray(made - columns @ (lever / scale[:, None]))


def held_out_gain(problem: FitProblem, key: str) -> tuple[float, float]:
    """Gain of the best candidate of `key` on slots that it was not fitted to, and its t-value.

    A linear fit at the recalibrated plant: each slot in turn is predicted by what the others say
    about the constants and the amount. Chance, and a fault of a few trials, do not carry over.
    """
    evidence = problem.evidence(problem.base)
    n = evidence.constants
    best = (-np.inf, 0.0)
    for j, candidate in enumerate(problem.candidates):
        if candidate.key != key:
            continue
        gains = []
        for unit in range(len(evidence.gram)):
            gains.append(
                _left_by(evidence, unit, [*range(n)])
                - _left_by(evidence, unit, [*range(n), n + 1 + j])
            )
        gain = np.array(gains)
        if len(gain) < 3:
            return float(gain.sum()), 0.0
        error = float(gain.std(ddof=1) * np.sqrt(len(gain)))
        best = max(best, (float(gain.sum()), float(gain.sum()) / max(error, 1e-9)))
    return best


def _left_by(evidence: Evidence, unit: int, columns: list[int]) -> float:
    """Whitened squares that a fit of `columns` to all other units leaves in one unit."""
    n = evidence.constants
    others = evidence.total - evidence.gram[unit]
    matrix = others[np.ix_(columns, columns)].copy()
    right = others[columns, n].copy()
    matrix[range(n), range(n)] += evidence.stiffness
    right[:n] += evidence.prior
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    even = matrix / scale / scale[:, None] + 1e-12 * np.eye(len(right))
    beta = np.linalg.solve(even, right / scale) / scale
    own = evidence.gram[unit]
    inner = own[np.ix_(columns, columns)]
    return float(own[n, n] - 2.0 * beta @ own[columns, n] + beta @ inner @ beta)
