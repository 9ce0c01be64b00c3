"""Where the gains come from: critical gains, and how the pressure loop answers. All nominal.

Nothing here is tuned on a case that is scored: gains follow from the rules of Ziegler and Nichols and
of the laws' own modules, on the finger without payload or effects.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from plant.constants import PlantConstants
from plant.errors import PlantError
from plant.finger import Finger, FingerSim
from plant.links.dynamics import gravity_torque
from rigs.control.bench import FingerBench
from rigs.control.loop import HOST_MS, run_law
from rigs.control.muscles import Pairs
from rigs.control.pid import Gains, Pid
from rigs.control.reference import STEP_POSTURE_DEG, step

Array = npt.NDArray[np.float64]
Respond = Callable[[float], tuple[Array, Array]]

FLOOR_DEG = 0.3
"""Oscillations smaller than this are the valve's and the sensor's, not the loop's."""


@dataclass(frozen=True)
class Critical:
    """The gain of sustained oscillation and its period."""

    gain: float
    period_s: float


def swing_growth(time_s: Array, y: Array, floor: float) -> float:
    """How an oscillation fares: its size in the last third over that in the third before.

    0 where the last third is smaller than `floor`.
    """
    third = len(y) // 3
    before, last = (np.std(part) for part in (y[-2 * third : -third], y[-third:]))
    if not np.isfinite(last):
        return float("inf")
    return 0.0 if last < floor else float(last / before)


def oscillation_period(time_s: Array, y: Array) -> float:
    """Mean time between upward passages through the mean, interpolated, s. `PlantError` if none."""
    wave = y - y.mean()
    up = np.flatnonzero((wave[:-1] < 0.0) & (wave[1:] >= 0.0))
    if len(up) < 3:
        raise PlantError("no oscillation to take a period from; raise the gain's upper bound")
    exact = time_s[up] - wave[up] * (time_s[up + 1] - time_s[up]) / (wave[up + 1] - wave[up])
    return float(np.diff(exact).mean())


def critical_gain(
    respond: Respond, low: float, high: float, floor: float = 0.0, rounds: int = 12
) -> Critical:
    """Raise a proportional gain until oscillations are sustained (section 1.5.1).

    Args:
        respond: a gain to (time, output) of the closed loop after a disturbance.
        low: a gain at which oscillations die out.
        high: a gain at which they grow, or stay at the limits.
        floor: standard deviation below which there is no oscillation.
        rounds: bisections on the logarithm of the gain.

    Raises:
        PlantError: `low` oscillates, or `high` does not.
    """
    sustained = 0.97
    for gain, wanted in ((low, False), (high, True)):
        if (swing_growth(*respond(gain), floor) >= sustained) != wanted:
            state = "dies out" if wanted else "is sustained"
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


def joint_critical(
    finger: Finger, constants: PlantConstants, joint: str, rounds: int = 6, hold_s: float = 3.0
) -> Critical:
    """Critical gain (kPa/rad) of one joint through the whole firmware; the others hold still."""
    index = finger.arm.joint(joint)
    pairs = Pairs(finger, constants)
    posture = np.radians(STEP_POSTURE_DEG)
    bias = pairs.delta(posture, gravity_torque(finger.arm, posture))

    def respond(gain: float) -> tuple[Array, Array]:
        gains = [
            Gains(gain if k == index else 0.0, float("inf"), 0.0) for k in range(len(finger.joints))
        ]
        reference = step(finger, joint, 5.0, hold_s, lead_s=0.1)
        trial = run_law(finger, constants, Pid(gains, bias), reference)
        return trial.time_s[100:], np.degrees(trial.q[100:, index])

    return critical_gain(respond, 5.0, 3000.0, FLOOR_DEG, rounds)


@dataclass(frozen=True)
class PressureResponse:
    """The pressure loop below, as dead time and lag: the firmware's scheme, valve and chamber."""

    dead_s: float
    lag_s: float


def pressure_response(
    finger: Finger, constants: PlantConstants, scheme: str = "burst", seed: int = 3
) -> PressureResponse:
    """Dead time and lag of delta after small steps, by Smith's 28 and 63 % (mean of 4 joints).

    Steps of 10 kPa up and down at the reference's first posture, from when the host speaks.
    """
    pairs = Pairs(finger, constants)
    posture = np.radians(STEP_POSTURE_DEG)
    base = pairs.delta(posture, gravity_torque(finger.arm, posture))
    sim = FingerSim(finger, constants)
    bench = FingerBench(sim, scheme, np.random.default_rng([seed, 82]))
    bench.begin()
    bench.ask(pairs.pressures(base))
    bench.run(1500)
    rows = []
    size, length = 10.0, 400
    for k in range(12):
        sign = 1.0 if k % 2 == 0 else -1.0
        before = base + (0.0 if sign > 0 else size)
        # Unequal pauses, so that the steps meet the scheme at all its phases.
        bench.run(7 * k)
        bench.ask(pairs.pressures(before + sign * size))
        for ms in range(length):
            if ms % HOST_MS == 0:
                pressure = sim.pressure_kpa
            pressure = sim.pressure_kpa
            rows.append((pressure[::2] - pressure[1::2]) / 2.0)
            bench.run(1)
    deltas = np.array(rows).reshape(12, length, -1)
    sign = np.where(np.arange(12) % 2 == 0, 1.0, -1.0)[:, None, None]
    first = deltas[:, :1]
    response = (sign * (deltas - first)).mean(axis=(0, 2))
    response = response / response[-100:].mean()
    t28, t63 = (float(np.argmax(response >= level)) * 1e-3 for level in (0.283, 0.632))
    lag = 1.5 * (t63 - t28)
    return PressureResponse(max(t63 - lag, 1e-3), max(lag, 1e-3))
