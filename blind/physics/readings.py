"""What the bench's instruments say of a trial when nothing shakes them: sensor effects only."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from blind.physics import numbers as n
from blind.physics.bench import Trial, run_trial
from blind.physics.stepping import OUT_A, OUT_F, OUT_FALL, OUT_L, OUT_P, OUT_TAP, OUT_V

Floats = np.ndarray


@dataclass(frozen=True)
class Readings:
    """Readings of each channel at the times asked for, and true states at the camera's times.

    pressure (kPa gauge), force (N), length (mm); speed (mm/s) and acceleration (mm/s2) are those
    of the load; `fall` is the largest fall of the supply (kPa).
    """

    pressure: Floats
    force: Floats
    length: Floats
    speed: Floats
    acceleration: Floats
    fall: float


def pressure_span(form: float, tap: Floats) -> Floats:
    """Error of a pressure gauge's span over the stated one, 1 at 300 kPa (forms held out)."""
    x = tap / 300.0
    if form == 3.0:  # straight from end to end, bowed in between
        return np.asarray(0.64 + 0.36 * x * (2.0 - x))
    if form == 4.0:  # the membrane stiffens
        return np.asarray(1.13 - 0.13 * x**2)
    if form == 6.0:  # the amplifier takes its next range, which is adjusted otherwise
        return np.where(tap < 371.0, 1.0, 0.57)
    return np.asarray(1.0 + 0.17 * np.sin(np.pi * x))  # S-shaped


def force_span(form: float, force: Floats) -> Floats:
    """Error of a force sensor's span over the stated one, 1 at 60 N (forms held out)."""
    x = force / 60.0
    if form == 3.0:  # the beam bends away from its load
        return np.asarray(1.0 / (0.87 + 0.13 * x * x))
    if form == 4.0:
        return np.asarray(0.66 + 0.34 * np.tanh(np.abs(x)) / np.tanh(1.0))
    return np.asarray(0.88 + 0.36 * np.maximum(np.abs(x) - 2.0 / 3.0, 0.0))  # meets a stop


def picture_scale(form: float, length: Floats) -> Floats:
    """Error of the camera's scale over the stated one, 1 at 60 mm (forms held out)."""
    x = length - 60.0
    if form == 3.0:  # a plane that is not the sensor's: projective
        return np.asarray(1.0 / (1.0 - 0.017 * x))
    return np.asarray(1.0 + 0.0043 * x * x)  # curved field


def picture_bend(form: float, x: Floats) -> Floats:
    """Distortion over that at the end of the range, x from -1 to 1 (forms held out)."""
    if form == 3.0:  # tangent against angle, a fisheye's
        return np.asarray((np.tan(0.9 * x) - 0.9 * x) / (np.tan(0.9) - 0.9))
    return np.asarray(0.45 * x * x + 0.55 * x**3)  # the lens's elements are decentred


def read_pressure(tap: Floats, t: Floats, trial: Trial, e: Floats) -> Floats:
    """Gauge pressure as shown."""
    out = tap.copy()
    form, gain = e[n.P_GAIN, 0], e[n.P_GAIN, 1] / 100.0
    if form == 1.0:  # bends: exact at 300 kPa
        out *= 1.0 + gain * (0.9 + 0.1 * tap / 300.0)
    elif form >= 3.0:
        out *= 1.0 + gain * pressure_span(form, tap)
    elif form >= 0.0:
        out *= 1.0 + gain
    form, zero = e[n.P_ZERO, 0], e[n.P_ZERO, 1]
    if form == 1.0:  # settles a little from trial to trial, exact in the mean
        out += zero * (1.0 + 0.06 * np.sin(1.9 * trial.order))
    elif form == 2.0:
        out += zero * (1.0 + 0.05 * (1 if trial.mounting % 2 else -1))
    elif form == 3.0:  # warms up through the session
        out += zero * (1.12 - 0.55 * np.exp(-trial.start_s / 2400.0))
    elif form == 4.0:  # settles anew in each trial
        out += zero * (1.03 - 0.28 * np.exp(-t / 7.0))
    elif form >= 0.0:
        out += zero
    if e[n.RIPPLE, 0] >= 0.0:
        out += e[n.RIPPLE, 1] * np.sin(2.0 * np.pi * e[n.RIPPLE, 2] * t + e[n.RIPPLE, 3])
    return out


def read_force(force: Floats, t: Floats, trial: Trial, e: Floats) -> Floats:
    """Force as shown."""
    out = force.copy()
    form, gain = e[n.F_GAIN, 0], e[n.F_GAIN, 1] / 100.0
    if form == 1.0:  # bends: exact at 60 N
        out *= 1.0 + gain * (0.9 + 0.1 * force / 60.0)
    elif form >= 3.0:
        out *= 1.0 + gain * force_span(form, force)
    elif form >= 0.0:
        out *= 1.0 + gain
    form, zero = e[n.F_ZERO, 0], e[n.F_ZERO, 1]
    if form == 1.0:
        out += zero * (1.0 + 0.06 * np.sin(2.3 * trial.order + 1.0))
    elif form == 2.0:
        out += zero * (1.0 + 0.05 * (1 if trial.mounting % 2 else -1))
    elif form == 3.0:  # follows the room, which follows the heating
        out += zero * (1.0 + 0.22 * np.cos(2.0 * np.pi * trial.start_s / 5400.0))
    elif form == 4.0:  # creeps back after the load before
        out += zero * (0.78 + 0.32 * (1.0 - np.exp(-t / 9.0)))
    elif form >= 0.0:
        out += zero
    if e[n.MAINS, 0] >= 0.0:
        out += e[n.MAINS, 1] * np.sin(2.0 * np.pi * 50.0 * t + 0.4) * (1.0 + 0.3 * np.sin(0.7 * t))
    if e[n.GRADIENT, 0] >= 0.0:  # the cell warms up while it is loaded, and overshoots
        x = t / e[n.GRADIENT, 2]
        out += e[n.GRADIENT, 1] * x * np.exp(1.0 - x)
    return out


def read_length(length: Floats, c: Floats, e: Floats) -> Floats:
    """Length as the camera shows it."""
    out = length.copy()
    low, high = c[n.L_MIN], c[n.L_MAX]
    form, scale = e[n.SCALE, 0], e[n.SCALE, 1] / 100.0
    if form == 1.0:  # the muscle comes nearer as it swells
        out *= 1.0 + scale * (1.0 + 0.012 * (60.0 - length))
    elif form == 2.0:
        out *= 1.0 + scale * (1.0 - 0.008 * (60.0 - length))
    elif form >= 3.0:
        out *= 1.0 + scale * picture_scale(form, length)
    elif form >= 0.0:
        out *= 1.0 + scale
    form, bend = e[n.DISTORTION, 0], e[n.DISTORTION, 1]
    if form >= 0.0:
        x = (length - 0.5 * (low + high)) / (0.5 * (high - low))
        if form == 1.0:  # fifth order joins in
            out += bend * (0.75 * x**3 + 0.25 * x**5)
        elif form == 2.0:  # division model
            out += bend * x**3 * 1.25 / (1.0 + 0.25 * x * x)
        elif form >= 3.0:
            out += bend * picture_bend(form, x)
        else:
            out += bend * x**3
    if e[n.PIXELS, 0] >= 0.0:
        out += e[n.PIXELS, 1] * np.sin(2.0 * np.pi * length / e[n.PIXELS, 2] + e[n.PIXELS, 3])
    return out


def frame_delay_s(t: Floats, e: Floats) -> Floats:
    """How much older than its stamp each frame is, s."""
    form, delay = e[n.FRAME_DELAY, 0], 1e-3 * e[n.FRAME_DELAY, 1]
    if form < 0.0:
        return np.zeros_like(t)
    if form == 1.0:  # the queue of frames breathes
        return np.asarray(delay * (1.0 + 0.12 * np.sin(2.0 * np.pi * t / 1.7)))
    if form == 2.0:
        return np.asarray(delay * (1.0 + 0.1 * np.sign(np.sin(2.0 * np.pi * t / 0.9))))
    if form == 3.0:  # two clocks beat: later and later, then a frame is dropped
        return np.asarray(delay * (0.86 + 0.28 * np.mod(t / 1.37, 1.0)))
    if form == 4.0:  # a busy line now and then
        return np.asarray(
            delay * (0.93 + 0.35 * np.maximum(np.sin(2.0 * np.pi * t / 2.3), 0.2) ** 3)
        )
    return np.full_like(t, delay)


def read_trial(
    trial: Trial,
    c: Floats,
    e: Floats,
    at_pressure: Floats,
    at_force: Floats,
    at_frames: Floats,
    scale: float = 1.0,
) -> Readings:
    """Noise-free readings of a trial at each channel's own instants (s, ascending)."""
    exposed = np.maximum(at_frames - frame_delay_s(at_frames, e), 0.0)
    every = np.concatenate([at_pressure, at_force, exposed])
    times, back = np.unique(every, return_inverse=True)
    states = run_trial(trial, c, e, times, scale)[back]
    a, b = len(at_pressure), len(at_pressure) + len(at_force)
    tap = states[:a, OUT_TAP] if e[n.P_LAG, 0] >= 0.0 else states[:a, OUT_P]
    return Readings(
        read_pressure(tap, at_pressure, trial, e),
        read_force(states[a:b, OUT_F], at_force, trial, e),
        read_length(states[b:, OUT_L], c, e),
        states[b:, OUT_V],
        states[b:, OUT_A],
        float(states[:, OUT_FALL].max()) if len(states) else 0.0,
    )


SETTLED_S = 2.0
"""A settled point is the mean of this last part of its dwell: a hung load swings on for long."""
_SETTLED_READINGS = 81


def read_settled(trial: Trial, c: Floats, e: Floats) -> Readings:
    """Noise-free readings of a trial's settled points, one a point in each channel."""
    assert trial.settled_s is not None
    back = np.linspace(-SETTLED_S, 0.0, _SETTLED_READINGS)
    t = (trial.settled_s[:, None] + back).ravel()
    r = read_trial(trial, c, e, t, t, t)

    def mean(values: Floats) -> Floats:
        return np.asarray(values.reshape(-1, len(back)).mean(axis=1))

    return replace(
        r, pressure=mean(r.pressure), force=mean(r.force), length=mean(r.length),
        speed=mean(r.speed), acceleration=mean(r.acceleration),
    )  # fmt: skip
