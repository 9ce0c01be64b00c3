"""The pressure at the outlet of a proportional regulator, from its set-points.

A dead time, the play between rising and falling set-points (hysteresis), offset and gain, a dead
band in which a regulator at rest does not react, and a first order lag with a limited speed. These
are the terms in which makers of proportional regulators state linearity, hysteresis, sensitivity
and response. Between two set-points the response has a closed form.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plant.arrays import Array

REST_SHARE = 0.05
REST_KPA = 0.05
"""A regulator that is so near to its target, or within this share of its dead band, rests."""


@dataclass(frozen=True)
class Regulator:
    """Identified dynamics; pressures in kPa, times in s.

    Attributes:
        dead_time_s: from a set-point to the first change of the pressure.
        time_constant_s: of the approach to it.
        slew_kpa_s: fastest change; infinite where it was not reached.
        dead_band_kpa: at rest, a smaller change of the set-point moves nothing.
        hysteresis_kpa: resting pressure after falling less that after rising.
        offset_kpa, gain_error: mean resting pressure: ``offset + (1 + gain_error) * set-point``.
    """

    dead_time_s: float
    time_constant_s: float
    slew_kpa_s: float
    dead_band_kpa: float
    hysteresis_kpa: float
    offset_kpa: float
    gain_error: float


def approach(
    elapsed_s: Array, start_kpa: float, end_kpa: float, lag_s: float, slew: float
) -> Array:
    """Pressure after a step: at the limited speed first, exponential once that is slower.

    Args:
        elapsed_s: times since the pressure begins to move, shape (n,).
        start_kpa, end_kpa: before and after.
        lag_s: time constant.
        slew: limit of the speed, kPa/s; may be infinite.

    Returns:
        kPa, shape (n,).
    """
    t = np.maximum(np.asarray(elapsed_s, dtype=np.float64), 0.0)
    distance = abs(end_kpa - start_kpa)
    knee = slew * lag_s
    if distance <= knee:
        left = distance * np.exp(-t / lag_s)
    else:
        until = (distance - knee) / slew
        after = np.maximum(t - until, 0.0)
        left = np.where(t < until, distance - slew * t, knee * np.exp(-after / lag_s))
    return np.asarray(end_kpa - np.sign(end_kpa - start_kpa) * left)


def respond(
    regulator: Regulator, set_s: Array, set_kpa: Array, time_s: Array, start_kpa: float = 0.0
) -> Array:
    """The pressure at the outlet.

    Args:
        regulator: its dynamics.
        set_s, set_kpa: when each set-point was given, rising, and its value; shape (m,).
        time_s: when the pressure is wanted, rising; shape (n,).
        start_kpa: outlet and set-point before the first one.

    Returns:
        kPa, shape (n,).
    """
    r = regulator
    out = np.full(len(time_s), start_kpa, dtype=np.float64)
    half = r.hysteresis_kpa / 2
    play = pressure = target = start_kpa
    begin_s = np.asarray(set_s, dtype=np.float64) + r.dead_time_s
    ends = np.append(begin_s[1:], np.inf)
    for begin, end, wanted in zip(begin_s, ends, set_kpa, strict=True):
        rests = abs(target - pressure) <= max(REST_SHARE * r.dead_band_kpa, REST_KPA)
        play = min(max(play, wanted - half), wanted + half)
        goal = r.offset_kpa + (1.0 + r.gain_error) * play if wanted > 0.0 else 0.0
        first, last = np.searchsorted(time_s, [begin, end])
        if rests and abs(goal - pressure) <= r.dead_band_kpa and wanted > 0.0:
            target = pressure
            out[first:last] = pressure
            continue
        target = goal
        out[first:last] = approach(
            time_s[first:last] - begin, pressure, target, r.time_constant_s, r.slew_kpa_s
        )
        if np.isfinite(end):
            after = approach(
                np.array([end - begin]), pressure, target, r.time_constant_s, r.slew_kpa_s
            )
            pressure = float(after[0])
    return out
