"""What the sensors of a bench show of the truth, with the effects that act on sensors.

Plain functions of arrays, without noise: zero and gain of pressure and force, the camera's scale,
distortion and delay, the supply channel that may not show a droop. The lag of the pressure
reading needs time and is followed by the kernel; `lagged` says the same of a recorded trace.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from plant.constants import PlantConstants
from plant.effects.effects import Effects
from plant.errors import PlantError
from plant.physics.additions import follow
from plant.physics.flow import drooped_supply
from plant.simulator.simulate import Traces

Array = npt.NDArray[np.float64]


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
        length_mm=delayed(traces.time_s, length, effects.get("camera_delay", "delay_ms") * 1e-3),
        supply_kpa=_supply(traces, constants, effects),
    )


def read_pressure(true_kpa: npt.ArrayLike, effects: Effects) -> Array:
    """Transducer with gain and zero, kPa: true (1 + percent / 100) + offset."""
    gain = effects.get("pressure_gain", "percent") / 100.0
    return np.asarray(true_kpa) * (1.0 + gain) + effects.get("pressure_zero", "offset_kpa")


def read_force(true_n: npt.ArrayLike, effects: Effects) -> Array:
    """Force sensor with gain and zero, N: true (1 + percent / 100) + offset."""
    gain = effects.get("force_gain", "percent") / 100.0
    return np.asarray(true_n) * (1.0 + gain) + effects.get("force_zero", "offset_n")


def read_length(true_mm: npt.ArrayLike, constants: PlantConstants, effects: Effects) -> Array:
    """Length that the camera gives for a true one, delay apart, mm.

        L = L_0 + (1 + percent / 100) (L_true - L_0) + distortion ((L_true - c) / (L_max - c))^3

    Radial distortion of the third order (Brown 1966), c being where it vanishes. Raises
    `PlantError` where that place is beyond the range.
    """
    true = np.asarray(true_mm, dtype=np.float64)
    read = true
    if "camera_scale" in effects:
        still = effects.get("camera_scale", "still_mm")
        read = still + (true - still) * (1.0 + effects.get("camera_scale", "percent") / 100.0)
    if "camera_distortion" in effects:
        low, high = constants.length_min_m * 1e3, constants.length_max_m * 1e3
        centre = (low + high) / 2.0 + effects.get("camera_distortion", "centre_mm")
        if not low - 1e-9 <= centre <= high - 0.1 * (high - low):
            raise PlantError(
                f"effect 'camera_distortion': centre_mm puts its centre at {centre:g} mm; it must "
                f"lie within {low:g} to {high - 0.1 * (high - low):g} mm"
            )
        bend = effects.get("camera_distortion", "distortion_mm")
        read = read + bend * ((true - centre) / (high - centre)) ** 3
    return np.asarray(read)


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
    """The supply channel: it shows the share `shown` of a droop at the inlet."""
    shown = effects.get("supply_droop", "shown")
    if shown == 0.0:
        return traces.supply_kpa
    droop = effects.get("supply_droop", "droop_kpa") * 1e3
    ratio = effects.get("critical_ratio", "critical_ratio", constants.critical_ratio)
    atmosphere = constants.atmosphere_pa
    supply = traces.supply_kpa * 1e3 + atmosphere
    inside = traces.pressure_kpa * 1e3 + atmosphere
    fallen = [
        drooped_supply(float(s), float(p), droop, ratio) if is_open else float(s)
        for s, p, is_open in zip(supply, inside, traces.inlet_open, strict=True)
    ]
    return np.asarray(traces.supply_kpa - shown * (supply - np.array(fallen)) * 1e-3)
