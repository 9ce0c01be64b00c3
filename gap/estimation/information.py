"""Inner products of residual and sensitivities: one small matrix for each held-out unit.

They are least squares with the covariance of the noise, over the columns
[constants | residual | candidates]. Constants carry their tolerance as a prior; candidates are
free. Linear gains, held-out fits and simulated null distributions use these matrices only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gap.estimation.config import ESTIMATION
from gap.estimation.noise import Noise
from gap.model.features import BLOCKS
from plant.arrays import Array

Whole = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Evidence:
    """Inner products of all columns, whitened and in natural units, by held-out unit.

    Attributes:
        constants: number of constant columns; the residual's column is at this index.
        prior: downhill slope of the constants' prior where the columns were taken.
        stiffness: curvature of that prior, both shape (constants,).
        offset: the prior's own cost there.
        unit: held-out unit of each trial, shape (trials,).
        gram: whitened inner products, shape (units, columns, columns).
        plain: time-weighted inner products by block, shape (units, columns, columns) each.
        weight: seconds (or points) behind `plain`, by block and unit, shape (units,) each.
    """

    constants: int
    prior: Array
    stiffness: Array
    offset: float
    unit: Whole
    gram: Array
    plain: dict[str, Array]
    weight: dict[str, Array]

    @property
    def total(self) -> Array:
        """Whitened inner products over all units."""
        return np.asarray(self.gram.sum(axis=0))


def gather(
    noise: Noise, constants: Array, residual: Array, candidates: Array, rows_block: Whole,
    rows_span: Array, units: Whole, shift: Array,
) -> Evidence:  # fmt: skip
    """Inner products of [constants | residual | candidates], all with one row a feature."""
    columns = np.hstack([constants, residual[:, None], candidates])
    count = int(units.max(initial=-1)) + 1
    width = columns.shape[1]
    gram = np.zeros((count, width, width))
    names = [name for number, name in enumerate(BLOCKS) if np.any(rows_block == number)]
    plain = {name: np.zeros((count, width, width)) for name in names}
    weight = {name: np.zeros(count) for name in names}
    for trial, rows in enumerate(noise.trial_rows):
        if not len(rows):
            continue
        part = columns[rows]
        whitened, _ = noise.solve(trial, part)
        gram[units[trial]] += whitened
        for name in names:
            here = rows_block[rows] == BLOCKS.index(name)
            if here.any():
                span = rows_span[rows][here]
                plain[name][units[trial]] += part[here].T @ (part[here] * span[:, None])
                weight[name][units[trial]] += float(span.sum())
    cost, slope, stiffness = tolerance(shift)
    return Evidence(constants.shape[1], -slope, stiffness, cost, units, gram, plain, weight)


def tolerance(shift: Array) -> tuple[float, Array, Array]:
    """Prior of constants moved by `shift` sd: cost, half its slope, half its curvature.

    A normal law up to three sd. Beyond, where no data sheet reaches, it turns into a steep wall:
    what a constant would have to do out there is no recalibration but an effect.
    """
    beyond = np.maximum(np.abs(shift) - ESTIMATION.tolerance_sd, 0.0)
    wall = ESTIMATION.beyond_weight
    cost = float(np.sum(shift**2 + wall * beyond**2))
    slope = shift + wall * beyond * np.sign(shift)
    return cost, slope, np.where(beyond > 0.0, 1.0 + wall, 1.0)


def projected(evidence: Evidence, gram: Array) -> Array:
    """Inner products of [residual | candidates] once the constants have taken what they can."""
    n = evidence.constants
    rest = slice(n, None)
    inner = gram[:n, :n] + np.diag(evidence.stiffness)
    across = gram[:n, rest].copy()
    across[:, 0] += evidence.prior
    made = gram[rest, rest].copy()
    made[0, 0] += evidence.offset
    if n:
        made -= across.T @ np.linalg.solve(inner, across)
    return np.asarray(made)


def _scale(matrix: Array) -> Array:
    """Unit of each parameter of a normal matrix: a leak's is thirty decades from a constant's."""
    diagonal = np.diag(matrix)
    return np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))


def damped_step(matrix: Array, right: Array, damping: float) -> Array:
    """Step of the damped normal equations (Marquardt)."""
    unit = _scale(matrix)
    stiff = matrix / unit / unit[:, None] + (damping + 1e-12) * np.eye(len(unit))
    try:
        return np.asarray(np.linalg.solve(stiff, right / unit)) / unit
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.pinv(stiff, hermitian=True) @ (right / unit)) / unit


def covariance(matrix: Array) -> Array:
    """Inverse of a normal matrix, worked out in units in which its parameters are alike."""
    unit = _scale(matrix)
    even = np.linalg.pinv(matrix / unit / unit[:, None], hermitian=True, rcond=1e-13)
    return np.asarray(even / unit / unit[:, None])
