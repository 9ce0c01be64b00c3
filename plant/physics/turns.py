"""A recorded path between its turns, without what its noise makes of it.

The path is made monotone from turn to turn by least squares (isotonic regression, pool adjacent
violators; Barlow, Bartholomew, Bremner and Brunk 1972). Noise moves no turn, and a path that is
monotone already stays as it is. Where the path rests before it turns, one reading that stands out
is no turn either: the levels of the rest are pooled.

Plain functions of arrays, compiled into `plant.physics.paths`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

LEAST = 6.0
"""Sd of a path's noise that are no turning back."""
_APART = 4.0
"""Sd of their difference by which two levels differ that noise does not make."""
_REST = 10.0
"""Readings near a turn from which the path rested there."""


def next_turn(x: Any, begin: int, end: int, least: float) -> tuple[int, float]:
    """The reading after the next turn of x from `begin` on, and the way till there.

    Without a turn that is `end`. A turn is the extreme before the path has come back by more than
    `least`. The way is 1 up, -1 down.
    """
    high, low, high_at, low_at, way = x[begin], x[begin], begin, begin, 0.0
    for i in range(begin + 1, end):
        if way >= 0.0 and x[i] > high:
            high, high_at = x[i], i
        if way <= 0.0 and x[i] < low:
            low, low_at = x[i], i
        if way == 0.0 and high - low > least:
            way = 1.0 if high_at > low_at else -1.0
        if way > 0.0 and high - x[i] > least:
            return high_at + 1, 1.0
        if way < 0.0 and x[i] - low > least:
            return low_at + 1, -1.0
    return end, -1.0 if way < 0.0 else 1.0


def monotone_levels(
    x: Any, begin: int, end: int, way: float, begins: Any, total: Any, count: Any
) -> int:
    """Levels of x made monotone over readings begin to end; returns how many.

    Args:
        begins, total, count: first reading, sum (times `way`) and number of readings of each level.
    """
    levels = 0
    for i in range(begin, end):
        begins[levels], total[levels], count[levels] = i, way * x[i], 1.0
        levels += 1
        while (
            levels > 1
            and total[levels - 1] * count[levels - 2] < total[levels - 2] * count[levels - 1]
        ):
            total[levels - 2] += total[levels - 1]
            count[levels - 2] += count[levels - 1]
            levels -= 1
    return levels


def resting(total: Any, count: Any, begin: int, end: int, step: int, noise: float) -> int:
    """Levels from `begin` towards `end`, by steps of 1 or -1, that noise alone may part.

    None where they are too few readings for a rest.
    """
    level, readings, levels = total[begin], count[begin], 1
    at = begin + step
    while at != end:
        apart = abs(total[at] / count[at] - level / readings)
        if apart > _APART * noise * np.sqrt(1.0 / count[at] + 1.0 / readings):
            break
        level += total[at]
        readings += count[at]
        levels += 1
        at += step
    return levels if levels > 1 and readings >= _REST else 0


def pool(total: Any, count: Any, begin: int, end: int) -> None:
    """Give the levels begin to end the mean of all their readings."""
    level, readings = 0.0, 0.0
    for at in range(begin, end):
        level += total[at]
        readings += count[at]
    for at in range(begin, end):
        total[at] = count[at] * level / readings
