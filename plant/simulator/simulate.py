"""Replay recorded commands through the plant in one compiled call.

pulses = pulse_train("inlet", start_s=0.0, width_s=0.0112, period_s=0.1, count=7)
traces = run_commands(nominal(), pulses, duration_s=0.8)
traces.pressure_kpa[-1]
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from plant.arrays import Array
from plant.constants import PlantConstants
from plant.effects.effects import NONE, Effects
from plant.effects.reference import TEMPERATURE_C as REFERENCE_TEMPERATURE_C
from plant.errors import PlantError
from plant.physics import layout
from plant.simulator.bench import Load, Source, build_params, build_state

Channel = Literal["inlet", "outlet", "length_rate_mm_s", "regulator_kpa", "supply_kpa"]

_CHANNELS: dict[str, tuple[int, float]] = {
    "inlet": (layout.CHANNEL_INLET, 1.0),
    "outlet": (layout.CHANNEL_OUTLET, 1.0),
    "length_rate_mm_s": (layout.CHANNEL_LENGTH_RATE, 1e-3),
    "regulator_kpa": (layout.CHANNEL_REGULATOR, 1e3),
    "supply_kpa": (layout.CHANNEL_SUPPLY, 1e3),
}


@dataclass(frozen=True)
class Commands:
    """Timed inputs: at `time_s[i]` input `channel[i]` takes `value[i]`; times never fall.

    Channels "inlet" and "outlet" are valve commands (1 fill or vent, 0 not; for a proportional
    valve anything between); the others are in the units of their names.
    """

    time_s: Array
    channel: tuple[str, ...]
    value: Array

    def __add__(self, other: Commands) -> Commands:
        """Both sets of inputs, in order of time; at equal times those of `self` first."""
        time_s = np.concatenate([self.time_s, other.time_s])
        order = np.argsort(time_s, kind="stable")
        channel = self.channel + other.channel
        value = np.concatenate([self.value, other.value])
        return Commands(time_s[order], tuple(channel[i] for i in order), value[order])


@dataclass(frozen=True)
class Traces:
    """Sampled answers of the plant, each of shape (samples,); true values, not readings."""

    time_s: Array
    pressure_kpa: Array
    length_mm: Array
    force_n: Array
    inlet_open: npt.NDArray[np.bool_]
    outlet_open: npt.NDArray[np.bool_]
    mass_in_kg: Array
    mass_out_kg: Array
    supply_kpa: Array
    """Set pressure of the supply; what it falls to while filling is in
    `plant.simulator.readings`."""
    pressure_read_kpa: Array
    """Pressure behind the transducer's lag, before its gain and zero."""


def commands(events: Sequence[tuple[float, Channel, float]]) -> Commands:
    """Inputs from (time_s, channel, value) rows in any order. Raises `PlantError`."""
    rows = sorted(events, key=lambda row: row[0])
    return Commands(
        np.array([row[0] for row in rows], dtype=np.float64),
        tuple(row[1] for row in rows),
        np.array([row[2] for row in rows], dtype=np.float64),
    )


def pulse_train(
    channel: Literal["inlet", "outlet"],
    start_s: float,
    width_s: float,
    period_s: float = 1.0,
    count: int = 1,
) -> Commands:
    """Equal pulses on one solenoid. Raises `PlantError` unless 0 < width <= period, count >= 1."""
    if not (0.0 < width_s <= period_s and count >= 1):
        raise PlantError(
            f"pulse train of {count} times {width_s!r} s every {period_s!r} s: "
            "expected 0 < width_s <= period_s and count >= 1"
        )
    begin = start_s + period_s * np.arange(count)
    time_s = np.column_stack([begin, begin + width_s]).ravel()
    return Commands(time_s, (channel,) * (2 * count), np.tile([1.0, 0.0], count))


def run_commands(  # noqa: PLR0913 - a recording has that many named conditions
    constants: PlantConstants,
    inputs: Commands,
    duration_s: float,
    rate_hz: float = 1000.0,
    effects: Effects = NONE,
    source: Source = "valve",
    load: Load = "isometric",
    length_m: float = 0.060,
    mass_kg: float = 1.0,
    pressure_kpa: float = 0.0,
    temperature_c: float = REFERENCE_TEMPERATURE_C,
    trials: float = 0.0,
) -> Traces:
    """Run `inputs` from rest and sample at `rate_hz` from time 0 to `duration_s`, both included.

    `length_m` is the length written down: with the effect `length_label` the muscle is held
    elsewhere. `temperature_c` is that of the muscle and `trials` what it has behind it, both for
    the effects that depend on them. `plant.simulator.readings` turns the traces into what sensors
    show.

    Raises `PlantError` for inputs out of order, before 0, not finite or on an unknown channel, and
    for a length, mass or pressure outside the plant's domain.
    """
    channel, value = _checked(inputs, constants.valve == "proportional")
    if not (duration_s > 0.0 and rate_hz > 0.0 and duration_s * rate_hz <= 1e8):
        raise PlantError(
            f"duration_s = {duration_s!r} at rate_hz = {rate_hz!r}: both must be positive, "
            "with at most 1e8 samples"
        )
    if not -constants.atmosphere_pa < pressure_kpa * 1e3 <= 1.2e6:
        raise PlantError(f"pressure_kpa = {pressure_kpa!r}; allowed above vacuum and up to 1200")
    params = build_params(constants, effects, source, load, mass_kg)
    if load == "isometric":
        length_m += float(held_offset_mm(length_m * 1e3, constants, effects)) * 1e-3
    state = build_state(constants, length_m, temperature_c, trials)
    state[layout.PRESSURE] = state[layout.PRESSURE_READ] = pressure_kpa * 1e3
    sample_s = np.arange(round(duration_s * rate_hz) + 1) / rate_hz
    lagging = params[layout.PRESSURE_LAG] > 0.0
    out = np.empty((len(sample_s), (layout.PRESSURE_READ if lagging else layout.MASS_OUT) + 1))
    from plant.simulator import replay  # compiled only where a recording is simulated

    replay.run(state, params, np.ascontiguousarray(inputs.time_s), channel, value, sample_s, out)
    return Traces(
        time_s=sample_s,
        pressure_kpa=out[:, layout.PRESSURE] * 1e-3,
        length_mm=out[:, layout.LENGTH] * 1e3,
        force_n=out[:, layout.FORCE].copy(),
        inlet_open=out[:, layout.INLET_OPEN] > 0.0,
        outlet_open=out[:, layout.OUTLET_OPEN] > 0.0,
        mass_in_kg=out[:, layout.MASS_IN].copy(),
        mass_out_kg=out[:, layout.MASS_OUT].copy(),
        supply_kpa=out[:, layout.SUPPLY] * 1e-3,
        pressure_read_kpa=out[:, layout.PRESSURE_READ if lagging else layout.PRESSURE] * 1e-3,
    )


def held_offset_mm(written_mm: npt.ArrayLike, constants: PlantConstants, effects: Effects) -> Array:
    """True minus written length of a muscle that is held, in mm, as `written_mm`."""
    written_m = np.asarray(written_mm, dtype=np.float64) * 1e-3
    off = np.zeros_like(written_m)
    for effect, values in effects.active():
        if effect.sensors.held is not None:
            off = off + effect.sensors.held(written_m, values, constants) * 1e3
    return off


def _checked(inputs: Commands, proportional: bool) -> tuple[npt.NDArray[np.int64], Array]:
    unknown = sorted(set(inputs.channel) - set(_CHANNELS))
    if unknown:
        raise PlantError(f"commands: unknown channel {unknown[0]!r}; known: {', '.join(_CHANNELS)}")
    count = len(inputs.channel)
    if inputs.time_s.shape != (count,) or inputs.value.shape != (count,):
        raise PlantError(
            f"commands: {count} channels, {inputs.time_s.shape} times and {inputs.value.shape} "
            "values; expected one of each per row"
        )
    if not (np.all(np.isfinite(inputs.time_s)) and np.all(np.isfinite(inputs.value))):
        raise PlantError("commands: a time or value is not a finite number")
    wrong = np.flatnonzero(np.diff(inputs.time_s, prepend=0.0) < 0.0)
    if len(wrong):
        row = int(wrong[0])
        raise PlantError(
            f"commands: row {row} at {inputs.time_s[row]:g} s comes before the row above it "
            "(or before 0); sort the rows by time"
        )
    for row, name in enumerate(inputs.channel):
        value = float(inputs.value[row])
        if name not in ("inlet", "outlet") or value in (0.0, 1.0):
            continue
        if not proportional or not 0.0 <= value <= 1.0:
            allowed = "0 to 1" if proportional else '0 or 1, with valve = "proportional" 0 to 1'
            raise PlantError(f"commands: row {row} sets {name} to {value:g}; allowed {allowed}")
    scale = np.array([_CHANNELS[name][1] for name in inputs.channel], dtype=np.float64)
    number = np.array([_CHANNELS[name][0] for name in inputs.channel], dtype=np.int64)
    return number, inputs.value * scale
