"""What the sensors of a bench show of the truth, with the effects that act on sensors.

Plain functions of arrays, without noise: zero and gain of pressure and force, the camera's scale,
distortion and delay, the supply channel that may not show a droop. The lag of the pressure
reading needs time and is followed by the kernel; `lagged` says the same of a recorded trace.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from plant.arrays import Array
from plant.constants import PlantConstants
from plant.effects.effects import Effects
from plant.physics.lag import follow
from plant.simulator.bench import build_params
from plant.simulator.simulate import Traces


@dataclass(frozen=True)
class Readings:
    """Channels as the sensors show them, each of shape (samples,)."""

    time_s: Array
    pressure_kpa: Array
    force_n: Array
    length_mm: Array
    supply_kpa: Array


def readings(traces: Traces, constants: PlantConstants, effects: Effects) -> Readings:
    """What every sensor shows of simulated `traces`. Raises `PlantError` with `read_length`."""
    length = read_length(traces.length_mm, constants, effects)
    return Readings(
        time_s=traces.time_s,
        pressure_kpa=read_pressure(traces.pressure_read_kpa, effects),
        force_n=read_force(traces.force_n, effects),
        length_mm=delayed(traces.time_s, length, camera_delay_s(effects)),
        supply_kpa=_supply(traces, constants, effects),
    )


def read_pressure(true_kpa: npt.ArrayLike, effects: Effects) -> Array:
    """Transducer with gain and zero, kPa: true (1 + gain) + zero; the gain may change with it."""
    gain, zero_kpa = pressure_error(effects)
    true = np.asarray(true_kpa, dtype=np.float64)
    read = true * (1.0 + gain) + zero_kpa
    for effect, values in effects.active():
        if effect.sensors.pressure_bent is not None:
            read = read + effect.sensors.pressure_bent(true * 1e3, values) * 1e-3
    return np.asarray(read)


def read_force(true_n: npt.ArrayLike, effects: Effects) -> Array:
    """Force sensor with gain and zero, N: true (1 + gain) + zero; the gain may change with it."""
    gain, zero_n = force_error(effects)
    true = np.asarray(true_n, dtype=np.float64)
    read = true * (1.0 + gain) + zero_n
    for effect, values in effects.active():
        if effect.sensors.force_bent is not None:
            read = read + effect.sensors.force_bent(true, values)
    return np.asarray(read)


def pressure_error(effects: Effects) -> tuple[float, float]:
    """Relative gain and zero (kPa) of the transducer."""
    hooks = [(effect.sensors.pressure, amount) for effect, amount in effects.headlines()]
    return _summed([hook(amount) for hook, amount in hooks if hook is not None])


def force_error(effects: Effects) -> tuple[float, float]:
    """Relative gain and zero (N) of the force sensor."""
    hooks = [(effect.sensors.force, amount) for effect, amount in effects.headlines()]
    return _summed([hook(amount) for hook, amount in hooks if hook is not None])


def _summed(errors: list[tuple[float, float]]) -> tuple[float, float]:
    return sum(gain for gain, _ in errors), sum(zero for _, zero in errors)


def read_length(true_mm: npt.ArrayLike, constants: PlantConstants, effects: Effects) -> Array:
    """Length that the camera gives for a true one, delay apart, mm; each error is of the true one.

    Raises `PlantError` where an error has no meaning for these constants.
    """
    read = np.asarray(true_mm, dtype=np.float64)
    true_m = read * 1e-3
    for effect, values in effects.active():
        if effect.sensors.camera is not None:
            read = read + effect.sensors.camera(true_m, values, constants) * 1e3
    return read


def camera_delay_s(effects: Effects) -> float:
    """How late the time stamps of the camera's frames are, in s."""
    hooks = [(effect.sensors.camera_delay, amount) for effect, amount in effects.headlines()]
    return sum(hook(amount) for hook, amount in hooks if hook is not None)


def delayed(time_s: Array, values: Array, delay_s: float) -> Array:
    """What a channel shows whose time stamps are late by `delay_s`: values(t - delay).

    Before the first and after the last sample the channel stands still.
    """
    if delay_s == 0.0:
        return values
    return np.asarray(np.interp(time_s - delay_s, time_s, values))


def lagged(time_s: Array, values: Array, time_constant_s: float) -> Array:
    """`values` behind a causal first-order lag, exact where they run straight between samples."""
    if time_constant_s <= 0.0:
        return np.asarray(values, dtype=np.float64)
    out = np.empty(len(values))
    out[0] = values[0]
    for k in range(1, len(values)):
        span = float(time_s[k] - time_s[k - 1])
        here, last = float(values[k]), float(values[k - 1])
        out[k] = follow(float(out[k - 1]), last, here, span, time_constant_s)
    return out


def _supply(traces: Traces, constants: PlantConstants, effects: Effects) -> Array:
    """The supply channel, which may show part of what the pressure at the inlet falls by."""
    shown = traces.supply_kpa
    params = build_params(constants, effects)
    supply = traces.supply_kpa * 1e3 + constants.atmosphere_pa
    inside = traces.pressure_kpa * 1e3 + constants.atmosphere_pa
    for effect, values in effects.active():
        if effect.sensors.supply is not None:
            fall = [
                effect.sensors.supply(float(s), float(p), params, values) if is_open else 0.0
                for s, p, is_open in zip(supply, inside, traces.inlet_open, strict=True)
            ]
            shown = shown - np.array(fall) * 1e-3
    return shown
