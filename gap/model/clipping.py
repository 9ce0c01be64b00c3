"""Readings at the end of what an instrument can show: the truth is there or beyond.

A converter that ends at its zero shows a vented muscle as zero, though the zero of the sensor is
below. Such readings look better than any others, and would move the zero, the gain and the supply.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from plant.arrays import Array

Mask = npt.NDArray[np.bool_]

CLIPPED_KPA = 2.0
"""Error of a mean of such readings: many times the zero of a sensor, so that it counts for nothing.
"""
CLIPPED_INPUT_KPA = 0.5
"""What the true pressure may be beyond such a reading, where it is what makes a force."""
_NEAR = 4.5
_FAR = 20.0
"""Steps of the reading from its lowest value, within which it is at rest and beyond which not."""
_LEAST_SHARE = 0.3
"""Share of the readings near the lowest value that are that value itself. Noise that is free to
fall below shows its lowest value seldom. No other value was tried."""
_FLICKERS = 0.6
"""Most pairs of neighbours far above that are equal: else there is no noise to miss below. No other
value was tried."""
_LEAST_COUNT = 20
_VENTED_KPA = 5.0
"""Most that a vented muscle reads: a lowest reading above is a pressure that was held."""


def at_lower_end(values: Array) -> Mask:
    """Which readings of a pressure in kPa, shape (n,), are at the lower end of what it can show.

    None where its noise does not stop there, nor where the muscle was never vented.
    """
    nowhere = np.zeros(len(values), dtype=bool)
    low = float(values.min(initial=np.inf))
    codes = np.unique(values)
    if len(codes) < 3 or low > _VENTED_KPA:
        return nowhere
    step = float(np.diff(codes[:9]).min())
    near, far = values < low + _NEAR * step, values > low + _FAR * step
    pairs = far[1:] & far[:-1]
    if min(int(near.sum()), int(pairs.sum())) < _LEAST_COUNT:
        return nowhere
    ends = values == low
    if float(ends[near].mean()) < _LEAST_SHARE:
        return nowhere
    equal = float((np.diff(values) == 0.0)[pairs].mean())
    return ends if equal < _FLICKERS else nowhere
