"""A first-order lag behind an input that is known at two instants."""

from __future__ import annotations

import numpy as np

STATED_PA = 4e5
"""Absolute pressure at which the lag of a gauge is stated that changes with the pressure."""
LEAST_PA = 1e4
"""Absolute pressure below which such a lag changes no more."""


def follow(value: float, before: float, after: float, duration: float, tau: float) -> float:
    """First-order follower of an input that runs straight from `before` to `after`.

    Exact for any duration: with z = t / tau and e = exp(-z),
    y' = e y + (1 - e) after - (after - before) ((1 - e) / z - e).
    """
    z = duration / tau
    if z < 1e-9:
        return value + z * (0.5 * (before + after) - value)
    e = np.exp(-z)
    mean = -np.expm1(-z) / z
    return float(e * value + (1.0 - e) * after - (after - before) * (mean - e))


def at_pressure(tau: float, power: float, absolute: float) -> float:
    """Time constant at an absolute pressure in Pa, stated at `STATED_PA`, s.

    It falls with a power of the pressure: a tube passes more of a denser gas.
    """
    if power == 0.0:
        return tau
    return float(tau * (max(absolute, LEAST_PA) / STATED_PA) ** -power)
