"""Channels and trials of a data set."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from plant.arrays import Array

CHANNELS = ("supply_kpa", "pressure_kpa", "length_mm", "force_n", "temperature_c")
"""Measured channels, in the units of their names."""
COMMANDS = ("inlet_cmd", "outlet_cmd")
"""Commanded channels, 0 or 1, held until the next value."""


@dataclass(frozen=True)
class Channel:
    """One channel of one trial: `value[i]` at `time_s[i]`, both shape (n,), times ascending.

    In a table of settled points `time_s` counts the rows.
    """

    time_s: Array
    value: Array

    def __len__(self) -> int:
        return len(self.value)


SAME_S = 1e-7
"""Instants that are no further apart are the same."""


def sampled(name: str, source: Channel | float, time_s: Array) -> Array:
    """A channel at `time_s`: commands held and 0 before their first row, others interpolated."""
    if not isinstance(source, Channel):
        return np.full(len(time_s), source)
    if name in COMMANDS:
        last = np.searchsorted(source.time_s, time_s + SAME_S, side="right") - 1
        return np.where(last >= 0, source.value[np.maximum(last, 0)], 0.0)
    return np.interp(time_s, source.time_s, source.value)


@dataclass(frozen=True)
class Trial:
    """One trial as the dataset format describes it; NaN where a number is not known.

    Attributes:
        order: place among the trials as they were measured; NaN where nobody stated it.
        slot: names the setting; trials of one slot are replicates of each other.
        tare_length_mm: where the muscle was held, vented, when the force was last set to zero.
        settled: a table of settled points, without time.
        direction: for settled points +1 up, -1 down, 0 unknown, one a row, shape (rows,).
        taken_s: when each settled point was read, s from the moment the muscle was brought to the
            first one, shape (rows,); empty or NaN where nobody stated it.
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
    taken_s: Array = field(default_factory=lambda: np.empty(0))

    def __contains__(self, channel: str) -> bool:
        return channel in self.channels

    def __getitem__(self, channel: str) -> Channel:
        return self.channels[channel]

    def get(self, channel: str) -> Channel:
        """Return the channel; one without samples if the trial has none of it."""
        return self.channels.get(channel, _EMPTY)


_EMPTY = Channel(np.empty(0), np.empty(0))
