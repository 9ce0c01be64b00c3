"""A data set for diagnosis: trials with their channels, whoever recorded them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from plant.arrays import Array
from plant.constants import PlantConstants
from plant.effects.effects import NONE, Effects

CHANNELS = ("supply_kpa", "pressure_kpa", "length_mm", "force_n", "temperature_c")
"""Measured channels, in the units of their names."""
COMMANDS = ("inlet_cmd", "outlet_cmd")
"""Commanded channels, 0 or 1, held until the next value."""
CALIBRATION = (
    "pressure_zero_kpa", "pressure_gain_percent", "force_zero_n", "force_gain_percent",
    "length_zero_mm", "length_gain_percent",
)  # fmt: skip
"""Keys of `calibration.toml`."""


@dataclass(frozen=True)
class Channel:
    """One channel of one trial: `value[i]` at `time_s[i]`, both shape (n,), times ascending.

    In a table of settled points `time_s` counts the rows.
    """

    time_s: Array
    value: Array

    def __len__(self) -> int:
        return len(self.value)


@dataclass(frozen=True)
class Trial:
    """One trial as the dataset format describes it; NaN where a number is not known.

    Attributes:
        slot: names the setting; trials of one slot are replicates of each other.
        order: position in time; 0 for all trials of a data set whose order is not known.
        tare_length_mm: where the muscle was held, vented, when the force was last set to zero.
        settled: a table of settled points, without time.
        direction: for settled points +1 up, -1 down, 0 unknown, one a row, shape (rows,).
    """

    name: str
    slot: str
    replicate: str
    protocol: str
    mounting: str
    order: float
    held_length_mm: float
    load_kg: float
    temperature_c: float
    start_s: float
    settled: bool
    channels: Mapping[str, Channel]
    direction: npt.NDArray[np.int64]
    tare_length_mm: float = float("nan")

    def __contains__(self, channel: str) -> bool:
        return channel in self.channels

    def __getitem__(self, channel: str) -> Channel:
        return self.channels[channel]

    def get(self, channel: str) -> Channel:
        """Return the channel; one without samples if the trial has none of it."""
        return self.channels.get(channel, _EMPTY)


_EMPTY = Channel(np.empty(0), np.empty(0))


@dataclass(frozen=True)
class DataSet:
    """Trials of one bench, and the constants of that bench as far as they are stated.

    Attributes:
        origin: the folder or run it came from, for messages.
        trials: in order of measurement.
        constants: the nominal plant with what `bench.toml` states.
        effects: effects that `bench.toml` switches on, so that they are no gap.
        notes: what a reader of the verdict should know (columns ignored, trials left out).
        calibration: standard uncertainty of what all trials share of a sensor's zero or gain, by
            `CALIBRATION`'s names; what is not stated is taken as exact.
    """

    origin: str
    trials: tuple[Trial, ...]
    constants: PlantConstants
    effects: Effects = NONE
    notes: tuple[str, ...] = field(default=())
    calibration: Mapping[str, float] = field(default_factory=dict)

    @property
    def slots(self) -> dict[str, list[int]]:
        """Indices of the trials of each slot, in order of first appearance."""
        slots: dict[str, list[int]] = {}
        for index, trial in enumerate(self.trials):
            slots.setdefault(trial.slot, []).append(index)
        return slots

    @property
    def mountings(self) -> npt.NDArray[np.int64]:
        """Number of the mounting of each trial, in order of first appearance; -1 if not stated."""
        labels = [trial.mounting for trial in self.trials]
        known = {label: k for k, label in enumerate(dict.fromkeys(filter(None, labels)))}
        return np.array([known.get(label, -1) for label in labels], dtype=np.int64)

    @property
    def settled(self) -> bool:
        """Whether every trial is a table of settled points."""
        return all(trial.settled for trial in self.trials)
