"""Dynamics of a proportional regulator from its responses to steps of the set-point.

Statics come from the resting pressures: offset and gain from all of them, hysteresis from the
difference after falling and after rising. Dead time, time constant and slew limit come from the
course of the large steps, by least squares over all of them at once; their uncertainties from
leaving out groups of steps (jackknife), so that what differs from step to step is in them. The dead
band comes from small steps away from rest: the first to move the pressure, and the last that did
not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from analysis.regression.regulator import Regulator, approach
from plant.arrays import Array

TIME_FLOOR_S = 0.0015
"""Standard uncertainty of a time on the controller's clock: its tick and the clock fit."""
REST_SHARE = 0.03
"""A regulator rests within a few hundredths of its dead band: u of a resting pressure."""
REST_KPA = 0.03
"""What is left of the approach when a pressure counts as resting."""
GROUPS = 10
REACHED = 0.15
"""The slew limit counts as reached where a step spends this share of its way at it."""
LEAST_STEPS = 6
SMOOTH = 20
AFTER = 300
NEAR_KPA = 1.0
"""Samples of a running mean, and after the last of them that is farther from rest than this."""


@dataclass(frozen=True)
class Response:
    """What followed one large step.

    Attributes:
        sent_s: when the set-point was written.
        set_kpa, from_kpa: the set-point, and the one before.
        before_kpa, after_kpa: resting pressures before and at the end.
        time_s, kpa: pressure from before the step to its end, shape (n,).
        replicate: which repeat it belongs to.
    """

    sent_s: float
    set_kpa: float
    from_kpa: float
    before_kpa: float
    after_kpa: float
    time_s: Array
    kpa: Array
    replicate: int = 1


@dataclass(frozen=True)
class Threshold:
    """Small steps away from rest: the largest that moved nothing, and the first that did, kPa."""

    still_kpa: float
    moved_kpa: float
    rising: bool


@dataclass(frozen=True)
class Identified:
    """The dynamics with standard uncertainties by name.

    Attributes:
        regulator: values; the slew limit is infinite where no step reached it.
        u: standard uncertainties (k = 1).
        misfit_kpa: rms of what the fit leaves of the steps.
        linearity_kpa: largest departure of a resting pressure from the line.
        slew_above_kpa_s: where the limit was not reached, the fastest change that was; else 0.
    """

    regulator: Regulator
    u: dict[str, float] = field(default_factory=dict)
    misfit_kpa: float = 0.0
    linearity_kpa: float = 0.0
    slew_above_kpa_s: float = 0.0


def identify(
    responses: Sequence[Response],
    thresholds: Sequence[Threshold],
    u_offset_kpa: float = 0.0,
    u_gain: float = 0.0,
) -> Identified:
    """The dynamics that explain the responses.

    Args:
        responses: large steps, up and down, at least `LEAST_STEPS`.
        thresholds: small steps, at least one.
        u_offset_kpa, u_gain: of the transducer that read the pressures.

    Raises:
        ValueError: too few steps, or steps of one direction only.
    """
    rising = [r for r in responses if r.set_kpa > r.from_kpa]
    if len(responses) < LEAST_STEPS or not thresholds or len(rising) in (0, len(responses)):
        raise ValueError(f"needs {LEAST_STEPS} steps up and down, and small steps")
    statics, u_statics, linearity = _statics(responses)
    band, u_band = _dead_band(thresholds)
    rest = float(np.hypot(REST_SHARE * band, REST_KPA))
    course = [_moving_part(r) for r in responses]
    moving, misfit = _course(course)
    kept = [_without(course, group, moving) for group in range(GROUPS)]
    spread = np.sqrt((GROUPS - 1) / GROUPS * ((kept - np.mean(kept, axis=0)) ** 2).sum(axis=0))
    slew, above = float(moving[2]), 0.0
    distances = [abs(r.after_kpa - r.before_kpa) for r in responses]
    if max(distances) - slew * moving[1] < REACHED * max(distances):
        slew, above = np.inf, max(distances) / float(moving[1])
        spread[2] = np.nan
    found = Regulator(
        float(moving[0]), float(moving[1]), slew, band, statics["hysteresis_kpa"],
        statics["offset_kpa"], statics["gain_error"],
    )  # fmt: skip
    u = {
        "dead_time_s": float(np.hypot(spread[0], TIME_FLOOR_S)),
        "time_constant_s": float(np.hypot(spread[1], TIME_FLOOR_S)),
        "slew_kpa_s": float(np.hypot(spread[2], TIME_FLOOR_S * slew / moving[1])),
        "dead_band_kpa": float(np.hypot(u_band, rest)),
        "hysteresis_kpa": float(np.hypot(u_statics["hysteresis_kpa"], 2 * rest)),
        "offset_kpa": float(np.hypot(np.hypot(u_statics["offset_kpa"], rest), u_offset_kpa)),
        "gain_error": float(np.hypot(u_statics["gain_error"], u_gain)),
    }
    u = {name: value for name, value in u.items() if np.isfinite(value)}
    return Identified(found, u, misfit, linearity, above)


def _statics(responses: Sequence[Response]) -> tuple[dict[str, float], dict[str, float], float]:
    """Offset, gain and hysteresis of the resting pressures, their u, and the largest residual."""
    used = [r for r in responses if r.set_kpa > 0.0]
    sets = np.array([r.set_kpa for r in used])
    rests = np.array([r.after_kpa for r in used])
    side = np.where(sets > [r.from_kpa for r in used], -0.5, 0.5)
    design = np.stack([np.ones_like(sets), sets, side], axis=1)
    solved, *_ = np.linalg.lstsq(design, rests, rcond=None)
    left = rests - design @ solved
    free = max(len(used) - 3, 1)
    covariance = np.linalg.inv(design.T @ design) * float(left @ left) / free
    u = np.sqrt(np.diag(covariance))
    slope = float(solved[1])
    values = {
        "offset_kpa": float(solved[0]),
        "gain_error": slope - 1.0,
        "hysteresis_kpa": max(float(solved[2]) / slope, 0.0),
    }
    uncertain = {
        "offset_kpa": float(u[0]), "gain_error": float(u[1]), "hysteresis_kpa": float(u[2] / slope),
    }  # fmt: skip
    return values, uncertain, float(np.abs(left).max())


def _dead_band(thresholds: Sequence[Threshold]) -> tuple[float, float]:
    """What lies above every step that moved nothing and below every one that moved; its u.

    Where no value does (the regulator's own scatter), the middle of the overlap, and half of it.
    """
    low = max(t.still_kpa for t in thresholds)
    high = min(t.moved_kpa for t in thresholds)
    width = (high - low) / np.sqrt(12) if high > low else (low - high) / 2
    return (low + high) / 2, float(width)


def _moving_part(response: Response) -> Response:
    """The response up to a little after the pressure has come to rest: the rest tells nothing."""
    smooth = np.convolve(response.kpa, np.ones(SMOOTH) / SMOOTH, mode="same")
    away = np.flatnonzero(np.abs(smooth - response.after_kpa)[:-SMOOTH] > NEAR_KPA)
    end = (int(away[-1]) if len(away) else 0) + AFTER
    return replace(response, time_s=response.time_s[:end], kpa=response.kpa[:end])


def _course(responses: Sequence[Response], near: Array | None = None) -> tuple[Array, float]:
    """Dead time, time constant and slew limit of the steps together, and the rms of the rest.

    Args:
        responses: the steps.
        near: values to begin with.
    """
    from scipy.optimize import least_squares

    distance = max(abs(r.after_kpa - r.before_kpa) for r in responses)
    first = np.array([0.02, np.log(0.15), np.log(3.0 * distance)])
    if near is not None:
        first = np.array([near[0], *np.log(near[1:])])

    def left(x: Array) -> Array:
        lag, slew = float(np.exp(x[1])), float(np.exp(x[2]))
        return np.concatenate(
            [
                r.kpa - approach(r.time_s - r.sent_s - x[0], r.before_kpa, r.after_kpa, lag, slew)
                for r in responses
            ]
        )

    bounds = ([0.0, np.log(2e-3), np.log(1.0)], [2.0, np.log(20.0), np.log(1e5)])
    best = least_squares(left, first, bounds=bounds, x_scale=[0.01, 0.1, 0.1])
    rms = float(np.sqrt(np.mean(best.fun**2)))
    return np.array([best.x[0], *np.exp(best.x[1:])]), rms


def _without(responses: Sequence[Response], group: int, near: Array) -> Array:
    kept = [r for k, r in enumerate(responses) if k % GROUPS != group]
    return _course(kept, near)[0]
