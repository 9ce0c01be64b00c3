"""The laws by name, with the gains that the tuning rules give on the nominal finger."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from plant.constants import PlantConstants
from plant.errors import PlantError
from plant.finger import Finger
from plant.links.dynamics import gravity_torque
from studies.controllers.adaptive import Adaptive
from studies.controllers.bench import Sensing
from studies.controllers.feedforward import MARGIN, FeedForward, critical_integral_rate
from studies.controllers.loop import HOST_MS, Law
from studies.controllers.model import Linear, linear_model
from studies.controllers.muscles import Pairs
from studies.controllers.pid import Gains, Pid, ziegler_nichols
from studies.controllers.placement import PolePlacement
from studies.controllers.reference import STEP_POSTURE_DEG
from studies.controllers.statics import StaticMap
from studies.controllers.tuning import (
    Critical,
    PressureResponse,
    loops_critical,
    pressure_response,
    static_gains,
)

SCHEMES = ("two", "duty_in", "duty", "slide", "burst")
"""Firmware schemes that stand alone: pressures from the muscle's law, no feedback of the angle."""
HOST_LAWS = ("pid", "placement", "feedforward", "adaptive")
"""Laws on the host; below them the firmware runs `burst` on every muscle."""
LAWS = (*SCHEMES, *HOST_LAWS)
TITLES = {
    "two": "two-position (5.7.1)",
    "duty_in": "PWM of the inlet (5.7.2)",
    "duty": "PWM of both (5.7.3)",
    "slide": "sliding mode (5.7.4)",
    "burst": "bursts",
    "pid": "PID, Ziegler-Nichols",
    "placement": "pole placement, observer",
    "feedforward": "feed-forward + integral",
    "adaptive": "adaptive feed-forward",
}


@dataclass(frozen=True)
class Tuning:
    """What the rules were given, and made, for one finger and valve block."""

    response: PressureResponse
    model: Linear
    dead_s: float
    lead_s: float
    critical_rate: float


@functools.lru_cache(maxsize=8)
def tuning(finger: Finger, constants: PlantConstants) -> Tuning:
    """Pressure response, linear model and integral rate; nominal, without payload."""
    response = pressure_response(finger, constants)
    model = linear_model(Pairs(finger, constants), np.radians(STEP_POSTURE_DEG), response.lag_s)
    # The response counts from the host's word; the angle's way back comes on top.
    dead = response.dead_s + Sensing().angle_delay_ms * 1e-3
    # A law speaks once in HOST_MS: what it says is half of that old on average.
    lead = response.dead_s + response.lag_s + HOST_MS * 0.5e-3
    return Tuning(response, model, dead, lead, critical_integral_rate(model, dead))


@functools.lru_cache(maxsize=8)
def critical(finger: Finger, constants: PlantConstants) -> Critical:
    """Critical gain of all joints' loops together, through the whole firmware; takes some seconds.

    One at a time, with the other loops open, each bears more (`provenance`), the outer ones three
    times as much: what one joint does shakes the next.
    """
    return loops_critical(finger, constants)


def pid_law(finger: Finger, constants: PlantConstants, found: Sequence[Critical]) -> Pid:
    """PID with Ziegler and Nichols's gains from the critical ones of each joint."""
    pairs = Pairs(finger, constants)
    posture = np.radians(STEP_POSTURE_DEG)
    gains = []
    for unit, one in zip(static_gains(pairs, posture), found, strict=True):
        relative = ziegler_nichols(one.gain, one.period_s)
        gains.append(Gains(relative.kp * unit, relative.ti_s, relative.td_s))
    return Pid(gains, pairs.delta(posture, gravity_torque(finger.arm, posture)))


def build_law(
    name: str, finger: Finger, constants: PlantConstants, found: Critical | None = None
) -> tuple[Law, str]:
    """A law ready to run, and the firmware scheme below it. Raises `PlantError` if unknown."""
    pairs = Pairs(finger, constants)
    if name in SCHEMES:
        return StaticMap(pairs), name
    if name == "pid":
        one = found or critical(finger, constants)
        return pid_law(finger, constants, [one] * len(finger.joints)), "burst"
    if name not in HOST_LAWS:
        raise PlantError(f"controller {name!r}: choose one of {', '.join(LAWS)}")
    t = tuning(finger, constants)
    if name == "placement":
        return PolePlacement(t.model, t.dead_s), "burst"
    rate = t.critical_rate / MARGIN
    if name == "feedforward":
        return FeedForward(pairs, t.model, t.lead_s, rate), "burst"
    return Adaptive(pairs, t.model, t.lead_s, rate), "burst"
