"""Zero, gain and linearity: a straight line through readings against a reference."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from daq.errors import ConfigError
from plant.arrays import Array

LEAST_POINTS = 3


@dataclass(frozen=True)
class Reference:
    """The reference of a calibration, with its standard uncertainty.

    Attributes:
        name: kind and identity, such as "gauge G-12, certificate 4711".
        u_each: of each value, independent between points (such as reading a dial), in the unit.
        u_offset: of its zero, common to all values, in the unit.
        u_gain: of its scale, common to all values, relative (weights: their class, and g).
    """

    name: str
    u_each: float = 0.0
    u_offset: float = 0.0
    u_gain: float = 0.0


@dataclass(frozen=True)
class LineFit:
    """``value = offset + scale * raw`` with standard uncertainties.

    Over the calibrated range ``hypot(u_offset, u_gain * (value - offset))`` is not smaller than
    the uncertainty of fit and reference. ``linearity`` is the largest residual.
    """

    offset: float
    scale: float
    u_offset: float
    u_gain: float
    linearity: float
    residuals: Array


def fit_line(
    raw: Sequence[float] | Array,
    u_raw: Sequence[float] | Array,
    value: Sequence[float] | Array,
    reference: Reference,
    where: str = "calibration",
) -> LineFit:
    """Weighted least squares, with the uncertainty of the reference.

    Args:
        raw: mean readings, shape (n,).
        u_raw: their standard uncertainties (repeatability), in raw units.
        value: values of the reference, in the calibrated unit.
        reference: the reference and its uncertainty.
        where: place named in messages.

    Returns:
        The line. The uncertainty of its offset includes that of the fit, the zero of the
        reference, and the largest residual as the half-width of a rectangular distribution
        (linearity). The uncertainty of its gain includes that of the fit and of the reference.

    Raises:
        ConfigError: too few points, or all at the same reading.
    """
    x, ux = np.asarray(raw, dtype=np.float64), np.asarray(u_raw, dtype=np.float64)
    y = np.asarray(value, dtype=np.float64)
    if len(x) < LEAST_POINTS:
        raise ConfigError(
            where, f"{len(x)} points, at least {LEAST_POINTS} are needed", "add points"
        )
    if not (np.isfinite(x).all() and np.isfinite(y).all()):
        raise ConfigError(where, "a point has no reading", "repeat it")
    if np.ptp(x) <= 1e-12 * max(1.0, float(np.abs(x).max())) or np.ptp(y) == 0.0:
        raise ConfigError(where, "all points are equal", "spread them over the range")
    scale = float(np.ptp(y) / np.ptp(x))
    design = np.column_stack([np.ones_like(x), x])
    beta = np.zeros(2)
    normal: Array = np.eye(2)
    for _ in range(5):
        variance = reference.u_each**2 + (scale * ux) ** 2
        floor = max(float(variance.max()), (1e-9 * float(np.ptp(y))) ** 2) * 1e-6
        weight = 1.0 / np.maximum(variance, floor)
        normal = np.asarray(np.linalg.inv(design.T @ (weight[:, None] * design)), dtype=np.float64)
        beta = normal @ (design.T @ (weight * y))
        scale = float(beta[1])
    residuals = y - design @ beta
    # A scatter above the stated uncertainty increases it; a smaller scatter does not reduce it.
    chi2 = float((weight * residuals**2).sum()) / (len(x) - 2)
    covariance = normal * max(1.0, chi2)
    linearity = float(np.abs(residuals).max())
    u_gain = float(np.hypot(np.sqrt(covariance[1, 1]) / abs(scale), reference.u_gain))
    u_offset = float(
        np.sqrt(covariance[0, 0] + reference.u_offset**2 + (linearity / np.sqrt(3.0)) ** 2)
    )
    # Offset and scale of a fit are correlated; a calibration has no correlation. If it matters
    # (readings of both signs), the uncertainty of the offset is increased to cover it.
    grid = np.linspace(x.min(), x.max(), 21)
    true = covariance[0, 0] + 2 * grid * covariance[0, 1] + grid**2 * covariance[1, 1]
    true += reference.u_offset**2 + (reference.u_gain * scale * grid) ** 2 + linearity**2 / 3
    short = float((true - u_offset**2 - (u_gain * scale * grid) ** 2).max())
    if short > 0:
        u_offset = float(np.sqrt(u_offset**2 + short))
    return LineFit(float(beta[0]), scale, u_offset, u_gain, linearity, residuals)
