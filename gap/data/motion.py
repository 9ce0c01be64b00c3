"""Whether a length that was read moves, and how much of what it shows is the camera's own noise."""

from __future__ import annotations

import numpy as np

from plant.arrays import Array

_MOVED_MM = 0.8
"""A length that moves by less is held; what was written down is then better than the camera."""
_OF_NOISE = 6.0
"""Range between the quantiles, in sd of the camera's noise, that noise alone never has: it makes
3.8 of white noise. No other value was tried."""
_MOST_NOISE_MM = 0.5
"""Noise beyond which a rough course is a motion that frames do not follow."""
_CALM_SHARE = 0.25
# What white noise of one sd makes of a fourth difference, and the quartile of its absolute value.
_OF_FOURTH = float(np.sqrt(70.0)) * 0.3186
_FEWEST_FRAMES = 20
_MOST_UNEVEN = 4.5
"""Upper quartile of absolute fourth differences over the lower one; white noise has 3.6. No other
value was tried; in 54 trials of another generator with a camera noise of 0.2 mm 3.0 to 4.0."""


def frame_noise(length: Array) -> float:
    """One sd of a camera's own noise, from fourth differences in the calmer part of a trial.

    A motion that frames follow leaves next to nothing in them. In the unit of the length; 0 where
    there are too few frames to tell.
    """
    if len(length) < _FEWEST_FRAMES:
        return 0.0
    return float(np.quantile(np.abs(np.diff(length, 4)), _CALM_SHARE)) / _OF_FOURTH


def is_white(length: Array) -> bool:
    """Whether the roughness of a length is that of white noise, alike all over the trial.

    A load that bounces between frames is rough as well, but in some parts more than in others.
    """
    if len(length) < _FEWEST_FRAMES:
        return False
    calm, rough = np.quantile(np.abs(np.diff(length, 4)), [_CALM_SHARE, 1.0 - _CALM_SHARE])
    return bool(rough <= _MOST_UNEVEN * calm)


def moves(length_mm: Array) -> bool:
    """Whether a length moves by more than noise and settling."""
    if len(length_mm) < 3:
        return False
    low, high = np.quantile(length_mm, [0.03, 0.97])
    noise = min(frame_noise(length_mm), _MOST_NOISE_MM)
    return bool(high - low > max(_MOVED_MM, _OF_NOISE * noise))
