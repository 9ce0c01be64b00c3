"""The scale of a sensor that changes over its range: what data sheets call its linearity error."""

from __future__ import annotations

import numpy as np

from plant.effects.arguments import Array

POWERS = (0.3, 3.0)
"""What a bend may be: from one at the foot of the range to one at its upper end."""


def linearity(straight: Array, full: float, power: float) -> Array:
    """Error beyond that of a straight scale that is as far off at the full value, in its unit.

    The scale is off by a share that grows with a power of the value: a linearity error between
    zero and the full value (IEC 61298-2). Zero for a power of zero.
    """
    return straight * (np.abs(straight / full) ** power - 1.0)
