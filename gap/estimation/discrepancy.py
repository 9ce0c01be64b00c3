"""Evidence of a fit beside an explicit model discrepancy: a smooth error of each stage's form.

No form is exact, and a bench may hold an effect that nobody has a name for. So what a fit leaves is
not noise alone: it is noise and an unknown smooth function of the inputs of each stage (Kennedy and
O'Hagan, J. R. Stat. Soc. B 63 (2001) 425). The function is a sum of Gaussian processes, one over
each group of inputs and one offset a slot, reduced to few terms. The size of each is not known: it
has a prior, and takes the value that the data make most likely (MacKay, Neural Comput. 4 (1992)
415). Two fits are compared by the probability of the data under each, with this function in both: a
form that leaves a pattern is judged by the size of that pattern where it acts, and a pattern in
another stage does not count against it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from gap.estimation.fit_problem import FitProblem, FitResult
from gap.estimation.information import tolerance
from gap.model.empirical import inputs_of
from gap.model.features import BLOCKS
from plant.arrays import Array

_GROUPS: tuple[tuple[str, ...], ...] = (
    ("pressure_kpa", "length_mm"), ("velocity_mm_s",), ("pressure_rate_kpa_s",), ("slip",),
    ("change_1s_kpa",), ("time_s",), ("temperature_c",), ("order",),
)  # fmt: skip
"""Inputs of the processes of every stage; the chamber also has the time since a valve's command."""
_OF_CHAMBER = ("valve", "since_edge_s")
_LONGEST_S = 2.0
_SOONEST_S = 0.004
_REACH = 0.35
"""Correlation length as a share of the range of an input."""
_NODES = 7
_KEPT = 0.995
_MOST_TERMS = {1: 6, 2: 14}
_PRIOR_SIZE = 0.02
"""Variance that the prior expects of each process, in units of the noise's: a small error."""
_PRIOR_WEIGHT = 1.0
"""Terms that the prior of the variance is worth."""
_ROUNDS = 25
_SETTLED = 0.02
"""Change of all logarithms of variances at which they count as found."""
_LEAST, _GREATEST = 1e-5, 1e7

Whole = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Evidence:
    """Logarithm of the probability of the data, and the variances at which it holds.

    Attributes:
        log: beside a constant that all fits of one problem share.
        variance: of each process in units of the noise's, shape (groups,).
        dispersion: whitened square a row that the discrepancy leaves too, at least 1.
    """

    log: float
    variance: Array
    dispersion: float = 1.0

    def above(self, other: Evidence) -> float:
        """How much more likely the data are than under another fit, as a logarithm.

        What no smooth function takes either makes all differences count less: a quasi-likelihood
        (McCullagh and Nelder, Generalized Linear Models, 1989, chapter 9).
        """
        return (self.log - other.log) / self.dispersion


class Discrepancy:
    """The terms of the discrepancy of one fit problem.

    Attributes:
        names: of the processes, "block: inputs", in the order of variances.
    """

    def __init__(self, problem: FitProblem) -> None:
        self.problem = problem
        self.names: tuple[str, ...] = ()
        parts: list[Array] = []
        for number, block in enumerate(BLOCKS):
            here = problem.rows.block == number
            if not here.any():
                continue
            for name, terms in _processes(problem, block, here):
                whole = np.zeros((len(problem.rows), terms.shape[1]))
                whole[here] = terms
                self.names = (*self.names, f"{block}: {name}")
                parts.append(whole)
        self._group = np.repeat(np.arange(len(parts)), [part.shape[1] for part in parts])
        columns = self._whitened(np.hstack(parts)) if parts else np.zeros((len(problem.rows), 0))
        # A variance of one is an error as large as the noise, on average over the rows it touches.
        for k, part in enumerate(parts):
            own = self._group == k
            rows = max(float(np.count_nonzero(np.any(part != 0.0, axis=1))), 1.0)
            columns[:, own] /= max(float(np.sqrt(np.sum(columns[:, own] ** 2) / rows)), 1e-12)
        self._columns = columns
        self._gram = columns.T @ columns
        self._start = np.full(len(parts), 0.1)
        self._known: list[tuple[FitResult, Evidence]] = []

    def evidence(self, fit: FitResult) -> Evidence:
        """Evidence of a fit, its constants and amounts integrated out around where they stand."""
        for known, found in self._known:
            if known is fit:
                return found
        found = self._evidence(fit)
        self._start = found.variance
        self._known.append((fit, found))
        return found

    def _evidence(self, fit: FitResult) -> Evidence:
        problem = self.problem
        n = len(problem.names)
        known = problem.columns_of(fit)
        low, high = np.array([s.bounds for s in fit.candidates]).reshape(-1, 2).T
        finite = np.where(np.isfinite(high - low), high - low, 0.0)
        own = self._whitened(np.hstack([known, fit.residual[:, None]]))
        known, residual = own[:, :-1], own[:, -1]
        offset, slope, stiffness = tolerance(fit.shift)
        # The range of an amount is its prior, half of it one sd; without a range what the data say
        # of it counts a hundred times as wide.
        size = np.sum(known[:, n:] ** 2, axis=0)
        loose = np.where(finite > 0.0, 4.0 / np.maximum(finite, 1e-150) ** 2, 1e-4 * size)
        prior = np.r_[stiffness, np.maximum(loose, 1e-12 * np.maximum(size, 1e-300))]
        whole = np.hstack([known, self._columns])
        across = known.T @ self._columns
        gram = np.block([[known.T @ known, across], [across.T, self._gram]])
        right = whole.T @ residual
        right[:n] -= slope
        width = known.shape[1]
        square = float(residual @ residual) + offset
        return self._most_likely(gram, right, square, prior, width)

    def _most_likely(
        self, gram: Array, right: Array, square: float, prior: Array, width: int
    ) -> Evidence:
        """The evidence at the variances that make it greatest together with their prior."""
        variance = self._start.copy()
        group = self._group
        count = np.bincount(group, minlength=len(variance)).astype(np.float64)
        best = Evidence(-np.inf, variance)
        for _ in range(_ROUNDS):
            precision = np.r_[prior, 1.0 / variance[group]]
            found = _solved(gram, right, precision)
            if found is None:
                break
            beta, inverse, log_det = found
            log = -0.5 * (square - float(right @ beta)) - 0.5 * log_det
            log += 0.5 * float(np.sum(np.log(precision)))
            log -= 0.5 * float(np.sum(_PRIOR_WEIGHT * (np.log(variance) + _PRIOR_SIZE / variance)))
            if log > best.log:
                over = (square - float(right @ beta)) / max(len(self._columns), 1)
                best = Evidence(log, variance, max(over, 1.0))
            taken = np.bincount(group, weights=beta[width:] ** 2, minlength=len(variance))
            free = (
                count
                - np.bincount(group, weights=inverse[width:], minlength=len(variance)) / variance
            )
            new = (taken + _PRIOR_WEIGHT * _PRIOR_SIZE) / (np.maximum(free, 0.0) + _PRIOR_WEIGHT)
            new = np.clip(new, _LEAST, _GREATEST)
            settled = float(np.abs(np.log(new / variance)).max(initial=0.0)) < _SETTLED
            variance = new
            if settled:
                break
        return best

    def _whitened(self, columns: Array) -> Array:
        made = np.zeros_like(columns)
        for trial, rows in enumerate(self.problem.noise.trial_rows):
            if len(rows):
                made[rows] = self.problem.noise.whiten(trial, columns[rows])
        return made


def _solved(gram: Array, right: Array, precision: Array) -> tuple[Array, Array, float] | None:
    """Solution, diagonal of the inverse, and log determinant of gram + diag(precision)."""
    whole = gram + np.diag(precision)
    unit = np.sqrt(np.diag(whole))
    even = whole / unit / unit[:, None] + 1e-12 * np.eye(len(unit))
    try:
        factor = cho_factor(even, lower=True)
    except LinAlgError:
        return None
    beta = cho_solve(factor, right / unit) / unit
    inverse = np.diag(cho_solve(factor, np.eye(len(unit)))) / unit**2
    log_det = 2.0 * float(np.sum(np.log(np.diag(factor[0]))) + np.sum(np.log(unit)))
    return beta, inverse, log_det


def _processes(
    problem: FitProblem, block: str, here: npt.NDArray[np.bool_]
) -> list[tuple[str, Array]]:
    """Name and terms of each process of a block, shape (rows of the block, terms)."""
    groups = [*_GROUPS, *([_OF_CHAMBER] if block == "pressure" else [])]
    names = tuple(dict.fromkeys(name for group in groups for name in group))
    at = inputs_of(problem.grid, block, names)
    if "since_edge_s" in at:
        # Valves take some ten milliseconds, gas some hundred: the logarithm sees both.
        at["since_edge_s"] = np.log(np.clip(at["since_edge_s"], _SOONEST_S, _LONGEST_S))
    made = []
    for group in groups:
        varied = [
            name for name in group if np.ptp(at[name]) > 1e-6 * (1.0 + np.abs(at[name]).max())
        ]
        if varied:
            terms = _terms(np.stack([at[name] for name in varied], axis=1))
            made.append((" and ".join(varied), terms))
    slots = problem.units[problem.rows.trial[here]]
    own = np.unique(slots)
    if len(own) > 1:
        made.append(("slot", (slots[:, None] == own).astype(np.float64)))
    return made


def _terms(x: Array) -> Array:
    """Terms of a Gaussian process of variance one over the range of inputs, shape (rows, terms)."""
    low, high = np.quantile(x, [0.01, 0.99], axis=0)
    wide = np.ptp(x, axis=0)
    span = np.maximum(high - low, 0.05 * wide)
    at = np.clip((x - low) / span, -0.2, 1.2) / _REACH
    grid = np.meshgrid(*[np.linspace(0.0, 1.0, _NODES) / _REACH] * x.shape[1])
    nodes = np.stack([g.ravel() for g in grid], axis=1)
    size, vectors = np.linalg.eigh(_alike(nodes, nodes))
    order = np.argsort(-size)
    size, vectors = size[order], vectors[:, order]
    share = np.cumsum(size) / size.sum()
    count = min(int(np.searchsorted(share, _KEPT)) + 1, _MOST_TERMS[x.shape[1]])
    return np.asarray(_alike(at, nodes) @ (vectors[:, :count] / np.sqrt(size[:count])))


def _alike(one: Array, other: Array) -> Array:
    square = ((one[:, None, :] - other[None, :, :]) ** 2).sum(axis=2)
    return np.asarray(np.exp(-0.5 * square))
