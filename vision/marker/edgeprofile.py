"""Response of a pixel to a step with Gaussian blur, as a table."""

from __future__ import annotations

import math

from numba import njit

TABLE = 1024  # longest profile table
STEPS_PER_SIGMA = 24.0

_SQRT_HALF = math.sqrt(0.5)
_INV_SQRT_2PI = 1.0 / math.sqrt(2.0 * math.pi)


@njit(cache=True, nogil=True)
def _phi2(t, sigma):  # type: ignore[no-untyped-def]
    """First integral of the normal distribution function."""
    z = t / sigma
    return t * 0.5 * (1.0 + math.erf(z * _SQRT_HALF)) + sigma * _INV_SQRT_2PI * math.exp(
        -0.5 * z * z
    )


@njit(cache=True, nogil=True)
def fill_table(sigma, table, core):  # type: ignore[no-untyped-def]
    """Tabulate F, dF/dd and dF/dsigma for |d| <= core with steps of ``sigma/24`` or less.

    Returns the number of entries per side and the step; entry k + side belongs to d = k * step.
    """
    step = max(sigma, 0.5) / STEPS_PER_SIGMA
    side = math.ceil(core / step) + 1
    if side > TABLE // 2 - 1:
        side = TABLE // 2 - 1
        step = core / (side - 1)
    inv = 1.0 / sigma
    for k in range(side + 1):
        d = k * step
        z1 = (d + 0.5) * inv
        z0 = (d - 0.5) * inv
        f = _phi2(d + 0.5, sigma) - _phi2(d - 0.5, sigma)
        g = 0.5 * (math.erf(z1 * _SQRT_HALF) - math.erf(z0 * _SQRT_HALF))
        h = _INV_SQRT_2PI * (math.exp(-0.5 * z1 * z1) - math.exp(-0.5 * z0 * z0))
        table[0, side + k] = f
        table[1, side + k] = g
        table[2, side + k] = h
        table[0, side - k] = 1.0 - f
        table[1, side - k] = g
        table[2, side - k] = -h
    return side, step
