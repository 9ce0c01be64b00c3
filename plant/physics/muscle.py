"""The muscle after Chou and Hannaford (1996), equations 4-4 to 4-8 of the thesis.

    F(p, L) = p (3 L^2 - b^2) / (4 pi n^2)        V(L) = (b^2 L - L^3) / (4 pi n^2)

p gauge pressure in Pa, L length in m, b braid length, n turns; F > 0 pulls the ends together.
F = -p dV/dL holds exactly: the muscle turns gas work into pulling work and loses none.
Arguments may be floats or arrays of any matching shapes.
"""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from plant.arrays import Array
from plant.constants import PlantConstants
from plant.errors import PlantError

Number = TypeVar("Number", float, Array)


# Plain formulas, floats or arrays, no validation: the kernel compiles these same functions.
def braid_force(p: Number, length: Number, b: float, n: float) -> Number:
    """Equation 4-8."""
    return p * (3.0 * length * length - b * b) / (4.0 * np.pi * n * n)


def braid_force_slope(p: Number, length: Number, n: float) -> Number:
    """dF/dL of equation 4-8."""
    return 6.0 * p * length / (4.0 * np.pi * n * n)


def braid_volume(length: Number, b: float, n: float) -> Number:
    """Equation 4-6."""
    return (b * b - length * length) * length / (4.0 * np.pi * n * n)


def braid_volume_slope(length: Number, b: float, n: float) -> Number:
    """dV/dL of equation 4-6."""
    return (b * b - 3.0 * length * length) / (4.0 * np.pi * n * n)


def liner_pressure(p: Any, lost: float, width: float) -> Any:
    """Pressure that reaches the braid when the liner keeps `lost` of it for itself.

        p_eff = w ln(1 + exp(-p_t / w) (exp(p / w) - 1))

    a softplus (smooth dead band) shifted so that p_eff(0) = 0 and p - p_eff tends to p_t exactly;
    `lost` = 0 gives p_eff = p. A threshold pressure of this kind is what Chou and Hannaford (1996)
    and Klute and Hannaford (2000) saw as the pressure that the bladder needs to meet the braid.
    """
    # exp((p_t - p) / w) - exp(-p / w): p_eff - p + p_t over w, without overflow at high p.
    return p - lost + width * np.log1p(np.exp((lost - p) / width) - np.exp(-p / width))


def force(p_pa: npt.ArrayLike, length_m: npt.ArrayLike, c: PlantConstants) -> Array:
    """Force in N at gauge pressure `p_pa` and length `length_m`; raises `PlantError`."""
    p, length = _checked(p_pa, length_m, c)
    return np.asarray(braid_force(p, length, c.braid_length_m, c.turns))


def volume(length_m: npt.ArrayLike, c: PlantConstants) -> Array:
    """Inner volume of the muscle in m3 without the dead volume; raises `PlantError`."""
    return np.asarray(braid_volume(_length(length_m, c), c.braid_length_m, c.turns))


def chamber_volume(length_m: npt.ArrayLike, c: PlantConstants) -> Array:
    """Gas volume in m3: muscle and dead volume V_0; raises `PlantError`."""
    return volume(length_m, c) + c.dead_volume_m3


def dvolume_dl(length_m: npt.ArrayLike, c: PlantConstants) -> Array:
    """dV/dL in m2; raises `PlantError`."""
    return np.asarray(braid_volume_slope(_length(length_m, c), c.braid_length_m, c.turns))


def dforce_dp(p_pa: npt.ArrayLike, length_m: npt.ArrayLike, c: PlantConstants) -> Array:
    """Partial derivative of the force by pressure in N/Pa, shape of both arguments broadcast."""
    p, length = _checked(p_pa, length_m, c)
    return np.asarray(braid_force(np.ones_like(p), length, c.braid_length_m, c.turns))


def dforce_dl(p_pa: npt.ArrayLike, length_m: npt.ArrayLike, c: PlantConstants) -> Array:
    """Partial derivative of the force by length in N/m: the stiffness at constant pressure."""
    p, length = _checked(p_pa, length_m, c)
    return np.asarray(braid_force_slope(p, length, c.turns))


def zero_force_length(c: PlantConstants) -> float:
    """Length in m at which the braid pulls nothing whatever the pressure: b / sqrt(3)."""
    return float(c.braid_length_m / np.sqrt(3.0))


def effective_pressure(p_pa: npt.ArrayLike, threshold_pa: float, width_pa: float) -> Array:
    """Gauge pressure left for the braid behind a liner; see `liner_pressure` for the form.

    Raises `PlantError` for a negative threshold or a width that is not positive.
    """
    if not (threshold_pa >= 0.0 and width_pa > 0.0):
        raise PlantError(
            f"liner with threshold {threshold_pa!r} Pa and width {width_pa!r} Pa: "
            "the threshold must be >= 0 and the width > 0"
        )
    return np.asarray(liner_pressure(np.asarray(p_pa, dtype=np.float64), threshold_pa, width_pa))


def _checked(p_pa: Any, length_m: Any, c: PlantConstants) -> tuple[Array, Array]:
    p = np.asarray(p_pa, dtype=np.float64)
    length = _length(length_m, c)
    bad = ~(np.isfinite(p) & (p > -c.atmosphere_pa))
    if np.any(bad):
        raise PlantError(
            f"pressure {p[bad].flat[0] / 1e3:g} kPa gauge is below vacuum or not a number; "
            f"allowed above {-c.atmosphere_pa / 1e3:g} kPa"
        )
    shaped_p, shaped_length = np.broadcast_arrays(p, length)
    return shaped_p, shaped_length


def _length(length_m: Any, c: PlantConstants) -> Array:
    length = np.asarray(length_m, dtype=np.float64)
    bad = ~((length > 0.0) & (length < c.braid_length_m))
    if np.any(bad):
        raise PlantError(
            f"length {length[bad].flat[0] * 1e3:g} mm is outside the braid; "
            f"allowed above 0 and below braid_length_mm = {c.braid_length_m * 1e3:g}"
        )
    return length
