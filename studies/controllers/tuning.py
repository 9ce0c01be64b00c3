"""Tuning on the nominal finger: critical gains and the response of the pressure loop.

Gains follow from the rules of Ziegler and Nichols and of the modules of the laws, for the finger
without payload or effects.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from plant.arrays import Array
from plant.constants import PlantConstants
from plant.errors import PlantError
from plant.finger import Finger, FingerSim
from plant.links.dynamics import gravity_torque
from studies.controllers.bench import FingerBench
from studies.controllers.loop import FINE_STEP_S, run_law
from studies.controllers.muscles import Pairs
from studies.controllers.pid import Gains, Pid
from studies.controllers.reference import GRID_S, STEP_POSTURE_DEG, step

Respond = Callable[[float], tuple[Array, Array]]

DISTURBED_AT_S = 0.1
FLOOR_DEG = 0.3
"""Smaller oscillations are caused by valve and sensor, not by the loop."""


@dataclass(frozen=True)
class Critical:
    """The gain of sustained oscillation and its period."""

    gain: float
    period_s: float


def swing_growth(time_s: Array, y: Array, floor: float) -> float:
    """Growth of an oscillation: standard deviation of the last third over that of the second.

    0 if that of the last third is below `floor`.
    """
    third = len(y) // 3
    before, last = float(np.std(y[-2 * third : -third])), float(np.std(y[-third:]))
    if not np.isfinite(last):
        return float("inf")
    return 0.0 if last < floor else last / before


def oscillation_period(time_s: Array, y: Array) -> float:
    """Mean time between upward crossings of the mean, in s. Raises `PlantError`."""
    wave = y - y.mean()
    up = np.flatnonzero((wave[:-1] < 0.0) & (wave[1:] >= 0.0))
    if len(up) < 3:
        raise PlantError("no oscillation to take a period from; raise the gain's upper bound")
    exact = time_s[up] - wave[up] * (time_s[up + 1] - time_s[up]) / (wave[up + 1] - wave[up])
    return float(np.diff(exact).mean())


def critical_gain(
    respond: Respond, low: float, high: float, floor: float = 0.0, rounds: int = 12
) -> Critical:
    """The proportional gain at which oscillations are sustained (section 1.5.1).

    Args:
        respond: (time, output) of the closed loop after a disturbance, for a gain.
        low: a gain at which oscillations decay.
        high: a gain at which they grow, or stay at the limits.
        floor: standard deviation below which there is no oscillation.
        rounds: bisections on the logarithm of the gain.

    Raises:
        PlantError: `low` oscillates, or `high` does not.
    """
    # The amplitude of a limit cycle varies by some percent between the thirds.
    sustained = 0.9
    for gain, wanted in ((low, False), (high, True)):
        if (swing_growth(*respond(gain), floor) >= sustained) != wanted:
            state = "decays" if wanted else "is sustained"
            raise PlantError(f"at gain {gain:g} the oscillation {state}; widen the search")
    for _ in range(rounds):
        middle = float(np.sqrt(low * high))
        if swing_growth(*respond(middle), floor) >= sustained:
            high = middle
        else:
            low = middle
    time_s, y = respond(high)
    half = len(y) // 2
    return Critical(float(np.sqrt(low * high)), oscillation_period(time_s[half:], y[half:]))


def loops_critical(
    finger: Finger,
    constants: PlantConstants,
    joints: tuple[str, ...] | None = None,
    rounds: int = 6,
    hold_s: float = 3.0,
) -> Critical:
    """Critical gain of the loops of some joints (default all) together, with the firmware.

    The gain is relative: 1 is the pressure that statically corrects the error, so that loops of
    different joints are comparable. The disturbance is a step of 5 degrees of one joint.
    """
    chosen = joints or finger.joints
    pairs = Pairs(finger, constants)
    posture = np.radians(STEP_POSTURE_DEG)
    bias = pairs.delta(posture, gravity_torque(finger.arm, posture))
    unit = static_gains(pairs, posture)
    begin = round(DISTURBED_AT_S / GRID_S)
    index = finger.arm.joint(chosen[0] if len(chosen) == 1 else "flexion")

    def respond(gain: float) -> tuple[Array, Array]:
        gains = [
            Gains(gain * unit[k] if joint in chosen else 0.0, float("inf"), 0.0)
            for k, joint in enumerate(finger.joints)
        ]
        reference = step(finger, finger.joints[index], 5.0, hold_s, DISTURBED_AT_S)
        trial = run_law(finger, constants, Pid(gains, bias), reference)
        return trial.time_s[begin:], np.degrees(trial.q[begin:, index])

    return critical_gain(respond, 0.02, 20.0, FLOOR_DEG, rounds)


def static_gains(pairs: Pairs, posture: Array) -> Array:
    """Delta per radian of each joint, the others fixed: stiffness / torque per kPa, kPa/rad."""
    delta = pairs.delta(posture, gravity_torque(pairs.finger.arm, posture))
    return np.asarray(pairs.stiffness(posture, delta) / pairs.gain(posture))


@dataclass(frozen=True)
class PressureResponse:
    """Dead time and lag of the pressure loop: firmware scheme, valve and chamber."""

    dead_s: float
    lag_s: float


def pressure_response(
    finger: Finger, constants: PlantConstants, scheme: str = "burst", seed: int = 3
) -> PressureResponse:
    """Dead time and lag of delta after small steps, by Smith's 28 and 63 % (mean of 4 joints).

    Steps of 10 kPa up and down at the first posture of the reference; time 0 is the command.
    """
    pairs = Pairs(finger, constants)
    posture = np.radians(STEP_POSTURE_DEG)
    base = pairs.delta(posture, gravity_torque(finger.arm, posture))
    sim = FingerSim(finger, constants, step_max_s=FINE_STEP_S)
    bench = FingerBench(sim, scheme, np.random.default_rng([seed, 82]))
    bench.begin()
    bench.set_pressures(pairs.pressures(base))
    bench.run(1500)
    rows = []
    size, length = 10.0, 400
    for k in range(12):
        sign = 1.0 if k % 2 == 0 else -1.0
        before = base + (0.0 if sign > 0 else size)
        # Unequal pauses, so that the steps occur at all phases of the scheme.
        bench.run(7 * k)
        bench.set_pressures(pairs.pressures(before + sign * size))
        for _ in range(length):
            pressure = sim.pressure_kpa
            rows.append((pressure[::2] - pressure[1::2]) / 2.0)
            bench.run(1)
    deltas = np.array(rows).reshape(12, length, -1)
    signs = np.where(np.arange(12) % 2 == 0, 1.0, -1.0)[:, None, None]
    response = (signs * (deltas - deltas[:, :1])).mean(axis=(0, 2))
    response = response / response[-100:].mean()
    t28, t63 = (float(np.argmax(response >= level)) * 1e-3 for level in (0.283, 0.632))
    lag = 1.5 * (t63 - t28)
    return PressureResponse(max(t63 - lag, 1e-3), max(lag, 1e-3))
