"""Least squares of many possible terms, with any slots left out, from inner products alone.

What is fitted besides the terms (the plant's constants within their tolerances, amounts of effects
in force) is fitted anew wherever slots are left out: a term may not live on what the constants took
from the slot that is predicted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from scipy.optimize import lsq_linear

from gap.estimation.fit_problem import FitProblem, FitResult
from gap.estimation.information import gather, tolerance
from gap.model.features import BLOCKS
from plant.arrays import Array

Whole = npt.NDArray[np.int64]


@dataclass(frozen=True)
class _Reduced:
    """Normal equations of the terms once the plant's constants have taken what they can.

    Attributes:
        matrix, right: of all term columns, shapes (terms, terms) and (terms,).
        taken: what the constants take of residual and terms, shape (constants, 1 + terms).
    """

    matrix: Array
    right: Array
    taken: Array


@dataclass
class HeldOutTerms:
    """Fits of term columns to the residual of one block, any slots left out.

    Attributes:
        constants: number of columns that are fitted in any case.
        gram: whitened inner products of [constants | residual | terms] by slot.
        plain: the same of the block, weighted by time only: squared errors.
        stiffness, slope: prior of the constants.
        penalty: prior of the terms' coefficients, shape (terms, terms).
        slots: numbers of the slots with rows of the block.
        room: least and most change of the constants without terms, shapes (constants,); None where
            only their prior holds them.
    """

    constants: int
    gram: Array
    plain: Array
    stiffness: Array
    slope: Array
    penalty: Array
    slots: tuple[int, ...]
    room: tuple[Array, Array] | None = None
    _reduced: dict[frozenset[int], _Reduced] = field(default_factory=dict, repr=False)

    @classmethod
    def of(
        cls, problem: FitProblem, fit: FitResult, block: str, columns: Array, penalty: Array,
        within: float | None = None, beside: Array | None = None,
    ) -> HeldOutTerms:  # fmt: skip
        """Gather the inner products; `columns` has one row a row of the block.

        Args:
            within: sd that no constant moves beyond, whatever is left out.
            beside: what the columns do to other blocks, one row a feature of the problem.
        """
        whole = np.zeros((len(problem.rows), columns.shape[1])) if beside is None else beside.copy()
        whole[problem.rows.block == BLOCKS.index(block)] = columns
        known = problem.columns_of(fit)
        evidence = gather(
            problem.noise, known, fit.residual, whole, problem.rows.block, problem.rows.compared_s,
            problem.units, np.zeros(known.shape[1]),
        )  # fmt: skip
        _, slope, stiffness = tolerance(fit.shift)
        low, high = np.array([s.bounds for s in fit.candidates]).reshape(-1, 2).T
        loose = 4.0 / np.maximum(high - low, 1e-30) ** 2
        slots = np.flatnonzero(evidence.weight[block] > 0.0)
        return cls(
            known.shape[1], evidence.gram, evidence.plain[block], np.r_[stiffness, loose],
            np.r_[slope, loose * fit.amounts], penalty, tuple(slots.tolist()),
            None if within is None else _room(fit, within),
        )  # fmt: skip

    def coefficients(self, chosen: Whole, without: frozenset[int] = frozenset()) -> Array:
        """Coefficients of the chosen columns, fitted to all slots but those `without`."""
        if not len(chosen):
            return np.empty(0)
        found = self._at(without)
        inner = found.matrix[np.ix_(chosen, chosen)] + self.penalty[np.ix_(chosen, chosen)]
        scale = np.sqrt(np.maximum(np.diag(inner), 1e-300))
        even = inner / scale / scale[:, None] + 1e-10 * np.eye(len(chosen))
        return np.asarray(np.linalg.solve(even, found.right[chosen] / scale) / scale)

    def moved(self, chosen: Whole) -> Array:
        """Change of the constants that goes with the chosen columns, fitted to all slots."""
        taken = self._at(frozenset()).taken
        return np.asarray(taken[:, 0] - taken[:, 1 + chosen] @ self.coefficients(chosen))

    def error(self, slot: int, chosen: Whole, without: frozenset[int] = frozenset()) -> float:
        """Squared error on a slot of the fit to all slots but that one and those `without`."""
        return self.error_of_fit(slot, chosen, without | {slot})

    def error_of_fit(self, slot: int, chosen: Whole, left: frozenset[int]) -> float:
        """Squared error on any slot of the fit to all slots but those that are `left` out."""
        beta = self.coefficients(chosen, left)
        n = self.constants
        taken = self._at(left).taken
        vector = np.r_[taken[:, 1 + chosen] @ beta - taken[:, 0], 1.0, -beta]
        at = np.r_[np.arange(n + 1), n + 1 + chosen]
        return float(vector @ self.plain[slot][np.ix_(at, at)] @ vector)

    def explained(self, chosen: Whole, without: frozenset[int]) -> float:
        """Chi-square that the chosen columns take from the slots that are not `without`."""
        return float(self.coefficients(chosen, without) @ self._at(without).right[chosen])

    def errors(self, chosen: Whole, without: frozenset[int] = frozenset()) -> Array:
        """Squared errors on every slot that is not `without`, each left out in turn."""
        return np.array([self.error(s, chosen, without) for s in self.slots if s not in without])

    def _at(self, left: frozenset[int]) -> _Reduced:
        if left not in self._reduced:
            n = self.constants
            keep = [s for s in range(len(self.gram)) if s not in left]
            gram = self.gram[keep].sum(axis=0)
            inner = gram[:n, :n] + np.diag(self.stiffness)
            scale = np.sqrt(np.maximum(np.diag(inner), 1e-300))
            across = gram[:n, n:].copy()
            across[:, 0] -= self.slope
            even = inner / scale / scale[:, None] + 1e-12 * np.eye(n)
            taken = np.linalg.solve(even, across / scale[:, None]) / scale[:, None]
            if self.room is not None:
                taken[:, 0] = _bounded(even, across[:, 0] / scale, *(x * scale for x in self.room))
                taken[:, 0] /= scale
            rest = gram[n:, n:] - gram[:n, n:].T @ taken
            self._reduced[left] = _Reduced(rest[1:, 1:], rest[1:, 0], taken)
        return self._reduced[left]


def _room(fit: FitResult, within: float) -> tuple[Array, Array]:
    """Change of constants and amounts that keeps the constants within so many sd."""
    free = np.full(len(fit.amounts), np.inf)
    return np.r_[-within - fit.shift, -free], np.r_[within - fit.shift, free]


def _bounded(matrix: Array, right: Array, low: Array, high: Array) -> Array:
    """Solution of normal equations between bounds."""
    root = np.linalg.cholesky(matrix)
    found = lsq_linear(root.T, np.linalg.solve(root, right), (low, high + 1e-9), method="bvls")
    return np.asarray(found.x)


def gain_and_errors(before: Array, after: Array) -> tuple[float, float]:
    """Sum over slots by which squared errors fall, and how many standard errors that is.

    The standard error is that of the mean difference of the slots' root errors: in squares one
    slot with a large gap would be all that counts.
    """
    root = np.sqrt(np.maximum(before, 0.0)) - np.sqrt(np.maximum(after, 0.0))
    n = len(root)
    spread = float(root.std(ddof=1)) if n > 1 else np.inf
    errors = float(root.mean()) * np.sqrt(n) / max(spread, 1e-300)
    return float(np.sum(before - after)), errors


def joined(parts: Sequence[Whole]) -> Whole:
    """Column numbers of several terms."""
    return np.concatenate(parts).astype(np.int64) if parts else np.empty(0, dtype=np.int64)
