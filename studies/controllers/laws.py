"""The control laws by name, with gains from the tuning rules on the nominal finger."""

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
"""Firmware schemes without feedback of the angle; the pressures follow from the muscle model."""
HOST_LAWS = ("pid", "placement", "feedforward", "adaptive")
"""Laws on the host; the firmware runs the scheme `burst` on every muscle."""
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
    """Inputs and results of the tuning rules for one finger and valve block."""

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
    # The response starts at the command of the host; the delay of the angle is added.
    dead = response.dead_s + Sensing().angle_delay_ms * 1e-3
    # A law commands every HOST_MS: the mean age of a command is half of that.
    lead = response.dead_s + response.lag_s + HOST_MS * 0.5e-3
    return Tuning(response, model, dead, lead, critical_integral_rate(model, dead))


@functools.lru_cache(maxsize=8)
def critical(finger: Finger, constants: PlantConstants) -> Critical:
    """Critical gain with the loops of all joints closed, with the firmware; takes some seconds.

    With the other loops open the critical gain of a joint is larger (`provenance`), three times
    for the outer joints, because the joints are coupled.
    """
    return loops_critical(finger, constants)


def pid_law(finger: Finger, constants: PlantConstants, found: Sequence[Critical]) -> Pid:
    """PID with Ziegler-Nichols gains from the critical gain of each joint."""
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
    """A law and its firmware scheme. Raises `PlantError` if the name is unknown."""
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
