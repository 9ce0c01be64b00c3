"""Caldwell's minimum-energy model, equations 4-9 to 4-18."""

from __future__ import annotations

import math

import numpy as np

from plant.arrays import Array
from plant.models.law import Past, SeparableLaw

_V = 2.0 / (3.0 * math.sqrt(3.0))
"""sin^2 cos at 54.7 degrees: the largest volume, divided by K (4-15)."""
_SINE0, _COSINE0 = math.sqrt(2.0 / 3.0), math.sqrt(1.0 / 3.0)


class Caldwell(SeparableLaw):
    """F = Eff p ((V_54.7 / V)(S_a + 2 E_a) - (S_a + 2 E_a at 54.7 degrees)), cos a = L / h.

    S_a = pi f h sin a cos a (4-14), E_a = pi f^2 sin^2 a / 4, V = (pi/4) f^2 h sin^2 a cos a
    (4-15; printed as (D/4)^2 pi L, which contradicts its own K). P_new of equation 4-17 is taken as
    p V_54.7 / V, the pressure after isothermal compression from the minimum-energy state: of the
    possible interpretations, it is closest to the published statistics. Valid for 0 < L < h.
    h, f and Eff are nearly one flat direction.
    """

    parameters = ("thread_length", "diameter_at_90", "efficiency")

    def arm(self, q: Array, length: Array) -> Array:
        """Force divided by pressure."""
        h, f, eff = q
        x = length / h
        sine = np.sqrt(1.0 - x * x)
        rest = np.pi * f * (h * _COSINE0 * _SINE0 + f / 3.0)
        return np.asarray(eff * (_V * np.pi * f * (h / sine + 0.5 * f / x) - rest))

    def arm_slope(self, q: Array, length: Array) -> Array:
        """Derivative with respect to L."""
        h, f, eff = q
        x = length / h
        s2 = 1.0 - x * x
        slope = h * x / (s2 * np.sqrt(s2)) - 0.5 * f / (x * x)
        return np.asarray(eff * _V * np.pi * f / h * slope)

    def swept(self, q: Array, length: Array) -> Array:
        """Minus the integral of `arm`, in closed form."""
        h, f, eff = q
        x = length / h
        rest = np.pi * f * (h * _COSINE0 * _SINE0 + f / 3.0)
        integral = _V * np.pi * f * (h * np.arcsin(x) + 0.5 * f * np.log(x)) - rest * x
        return np.asarray(-eff * h * integral)

    def jacobian(self, q: Array, p: Array, length: Array, t: Array, path: Past = None) -> Array:
        """With respect to h, f and Eff."""
        h, f, eff = q
        x = length / h
        s2 = 1.0 - x * x
        sine = np.sqrt(s2)
        by_h = _V * np.pi * f * (1.0 / sine - x * x / (s2 * sine) + 0.5 * f / (x * h))
        by_h = by_h - np.pi * f * _COSINE0 * _SINE0
        by_f = _V * np.pi * (h / sine + f / x) - np.pi * (h * _COSINE0 * _SINE0 + 2.0 * f / 3.0)
        return np.stack([p * eff * by_h, p * eff * by_f, p * self.arm(q, length) / eff])
