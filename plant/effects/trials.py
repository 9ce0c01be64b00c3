"""Signals of a data set, trial by trial."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

from plant.effects.arguments import Points, Whole


def moved(points: Points, values: Any, ahead_s: float) -> Any:
    """Values of a signal `ahead_s` later, trial by trial, ends held; settled points stay."""
    if ahead_s == 0.0:
        return values
    made = values.copy()
    for a, b in pairwise(points.first.tolist()):
        if b - a > 2 and not points.settled[a]:
            t = points.time_s[a:b]
            made[a:b] = np.interp(t + ahead_s, t, values[a:b])
    return made


def travelled(points: Points) -> Any:
    """Length less that at the begin of each trial, without the noise of single readings.

    It is the sum of the speed, which is taken over as many readings as the motion is straight.
    """
    made = np.zeros(len(points.length))
    for a, b in pairwise(points.first.tolist()):
        if b - a > 2 and not points.settled[a]:
            mean = 0.5 * (points.rate[a + 1 : b] + points.rate[a : b - 1])
            made[a + 1 : b] = np.cumsum(mean * np.diff(points.time_s[a:b]))
    return made


def bend(points: Points, values: Any) -> Any:
    """Second derivative in time; settled points have none."""
    return _slope(points, _slope(points, values))


def _slope(points: Points, values: Any) -> Any:
    made = np.zeros(len(values))
    for a, b in pairwise(points.first.tolist()):
        if b - a > 2 and not points.settled[a]:
            made[a:b] = np.gradient(values[a:b], points.time_s[a:b])
    return made


def in_order(points: Points) -> Whole:
    """Index of each point in the order in which it was taken, trial by trial.

    The order of the rows of a table says nothing. Settled points go by their directions: up from
    the lowest pressure, then down from the highest; one without a direction goes with those up.
    """
    at = np.arange(len(points.length))
    for a, b in pairwise(points.first.tolist()):
        if b > a and points.settled[a]:
            falling = points.direction[a:b] < 0.0
            height = np.where(falling, -points.pressure[a:b], points.pressure[a:b])
            at[a:b] = a + np.lexsort((height, falling))
    return at


def without_noise_turns(points: Points, travel: Any) -> Any:
    """A path without the turns that only its reading noise makes.

    Fibres that slip would come to rest at each of them, and friction would look too small.
    """
    from plant.physics import paths

    if np.any(points.direction != 0.0):
        return np.ascontiguousarray(travel)
    noise = np.zeros(len(points.first) - 1)
    for trial, (a, b) in enumerate(pairwise(points.first.tolist())):
        if b - a > 4:
            rough = travel[a + 1 : b - 1] - 0.5 * (travel[a : b - 2] + travel[a + 2 : b])
            noise[trial] = 1.4826 * float(np.median(np.abs(rough))) / np.sqrt(1.5)
    made = np.empty(len(travel))
    paths.between_turns(points.first, np.ascontiguousarray(travel), noise, made)
    return made
