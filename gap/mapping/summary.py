"""What an import understood: each channel, each trial, the groups of replicates."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from gap.data.dataset import DataSet
from gap.data.trial import Trial
from gap.mapping.assemble import MuscleSet
from gap.mapping.mapping import Mapping, Measured, State
from plant.arrays import Array

_LONG = 5.0
"""A step longer than this many usual ones is a gap."""


@dataclass(frozen=True)
class ChannelSummary:
    """One channel over all trials; None where it does not apply.

    Attributes:
        name: of the dataset format.
        column: of the file, with the file where it is another than the main one.
        unit: in the file, and what was done to the value.
        low, high: range in the unit of `name`.
        samples: over all trials.
        rate_hz: from the usual step between samples.
        gaps: steps more than five times as long as the usual one.
        longest_gap_s: the longest of them.
        noise: standard deviation from second differences, which a smooth signal hardly has.
    """

    name: str
    column: str
    unit: str
    low: float
    high: float
    samples: int
    rate_hz: float | None
    gaps: int
    longest_gap_s: float | None
    noise: float | None


@dataclass(frozen=True)
class TrialSummary:
    """One trial; None where it does not apply."""

    name: str
    slot: str
    replicate: str
    rows: int
    duration_s: float | None
    pressure_low_kpa: float | None
    pressure_high_kpa: float | None


def channels_of(mapping: Mapping, data: DataSet) -> list[ChannelSummary]:
    """Each channel that the mapping brings in, as the diagnosis will read it."""
    made = [
        _channel(data, channel.name, _place(channel), _unit(channel))
        for channel in mapping.channels
    ]
    return made + [
        _channel(data, name, _place(state), _rule(state))
        for name, state in mapping.commands.items()
    ]


def _place(one: Measured | State) -> str:
    name = one.stream.column.removeprefix("#")
    return f"{one.stream.file}: {name}" if one.stream.file else name


def _unit(channel: Measured) -> str:
    text = channel.unit
    if channel.signal:
        text = f"{channel.factor:g} {channel.unit}/{channel.signal}"
    elif channel.factor != 1.0:
        text = f"{channel.factor:g} x {channel.unit}"
    if channel.addend:
        text += f", {channel.addend:+g} {channel.unit}"
    if channel.ambient_kpa:
        text += f", absolute, less {channel.ambient_kpa:g} kPa"
    return text


def _rule(state: State) -> str:
    if state.bit is not None:
        return f"bit {state.bit}"
    if state.on is not None:
        return "on: " + ", ".join(f"{v:g}" if isinstance(v, float) else v for v in state.on)
    if state.span is not None:
        way = f"shut {state.span[0]:g}, open {state.span[1]:g}"
        return f"{way}, pulses of {state.pwm_period_ms:g} ms" if state.pwm_period_ms else way
    return f"above {state.above:g}" if state.above is not None else "0 or 1"


def _channel(data: DataSet, name: str, column: str, unit: str) -> ChannelSummary:
    here = [trial for trial in data.trials if name in trial]
    if not here:
        return ChannelSummary(
            name, column, unit, float("nan"), float("nan"), 0, None, 0, None, None
        )
    value = np.concatenate([trial[name].value for trial in here])
    steps = [np.diff(trial[name].time_s) for trial in here if not trial.settled]
    step = np.concatenate(steps) if steps else np.empty(0)
    usual = float(np.median(step)) if len(step) else 0.0
    command = name.endswith("_cmd")
    long = step[step > _LONG * usual] if not command else np.empty(0)
    return ChannelSummary(
        name, column, unit, float(value.min()), float(value.max()), len(value),
        1.0 / usual if usual > 0.0 and not command else None,
        len(long), float(long.max()) if len(long) else None,
        None if command else _noise(here, name),
    )  # fmt: skip


def _noise(trials: list[Trial], name: str) -> float | None:
    """Robust spread of second differences over sqrt(6): white noise of one sd makes that."""
    bends: list[Array] = [np.diff(t[name].value, 2) for t in trials if not t.settled]
    bend = np.concatenate(bends) if bends else np.empty(0)
    if len(bend) < 10:
        return None
    return float(1.4826 * np.median(np.abs(bend - np.median(bend))) / np.sqrt(6.0))


def trials_of(own: MuscleSet, data: DataSet) -> list[TrialSummary]:
    """Each trial as the diagnosis will read it."""
    rows = {
        str(row["trial"]): len(frame) for row, frame in zip(own.trials, own.samples, strict=True)
    }
    made = []
    for trial in data.trials:
        pressure = trial.get("pressure_kpa").value
        times = [channel.time_s for channel in trial.channels.values()]
        duration = max(float(t[-1]) for t in times) if times and not trial.settled else None
        low, high = (
            (float(pressure.min()), float(pressure.max())) if len(pressure) else (None, None)
        )
        made.append(
            TrialSummary(
                trial.name,
                trial.slot,
                trial.replicate,
                rows.get(trial.name, 0),
                duration,
                low,
                high,
            )
        )
    return made


def replicates_of(data: DataSet) -> dict[str, int]:
    """Trials of each slot."""
    return dict(Counter(trial.slot for trial in data.trials))
