"""Normal equations of parameters whose units lie thirty decades apart."""

from __future__ import annotations

import numpy as np

from plant.arrays import Array


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
