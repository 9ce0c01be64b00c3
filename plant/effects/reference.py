"""The state at which headline parameters are stated."""

from __future__ import annotations

import numpy as np

from plant.arrays import Array
from plant.constants import PlantConstants
from plant.physics.friction import REFERENCE_PRESSURE_PA

LENGTH_M = 0.060
"""Length at which a stiffness and a shortening are stated."""
BRAID_LENGTH_M = 0.0884
"""Braid length of the bench that `LENGTH_M` belongs to."""
FULL_PRESSURE_PA = 500e3
"""Pressure at which a stretch and a change with temperature are stated."""
MIDDLE_PRESSURE_PA = REFERENCE_PRESSURE_PA
"""Pressure at which a friction, a damping and a limit are stated if they depend on the pressure."""
TYPICAL_FORCE_N = 30.0
"""Force by which the diagnosis scales a relative change in a form without pressure and length."""
TEMPERATURE_C = 21.0
"""Temperature of no change: that of the column of Table C-1 behind the constants."""


def length_of(c: PlantConstants) -> float:
    """`LENGTH_M` in proportion to the braid of another bench, m."""
    return LENGTH_M * size_of(c) / BRAID_LENGTH_M


def size_of(c: PlantConstants) -> float:
    """Braid length of a muscle, by which its lengths are in proportion, m.

    Of a cylinder, that of a muscle as long as its longest.
    """
    return c.length_max_m / _LONGEST if c.actuator == "cylinder" else c.braid_length_m


_LONGEST = 72.5 / 88.4
"""Length of the reference bench's muscle at the long stop, in braid lengths."""


def middle_of(c: PlantConstants) -> float:
    """Middle of the range of lengths, m."""
    return 0.5 * (c.length_min_m + c.length_max_m)


def taken_up(p: Array, scale_kpa: float) -> Array:
    """Share of a slack that pressure p (Pa) has taken up, of that at `FULL_PRESSURE_PA`."""
    scale = 1e3 * scale_kpa
    share = np.expm1(-np.maximum(p, 0.0) / scale) / np.expm1(-FULL_PRESSURE_PA / scale)
    return np.asarray(share)
