"""What reads and what sets: the two interfaces that devices of a bench have in common.

`Instrument` gives readings of one quantity. `Actuator` sets one quantity and returns what was set,
as a sensor or the device itself reports it. A device may be both. What sets the muscle's pressure
has more duties and an interface of its own, `rigs.devices.pressure.source.PressureSource`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
import numpy.typing as npt

from daq.calibration import Calibration
from rigs.devices.faults import Faults

Rows = dict[str, npt.NDArray[np.generic]]
"""Columns of a stream of the record, all of one length."""


class Instrument(Protocol):
    """Gives readings of one quantity; a reading that is not certain never becomes a value.

    Attributes:
        quantity: what it measures, with unit: ``temperature_c``.
        unit: unit of the readings as they come.
        calibration: turns readings into ``quantity``; None where they are that already.
        columns: of its stream in a record.
        rate_hz: readings a second.
        identity: what it reports about itself; filled by :meth:`connect`.
        rows: readings so far.
        faults: everything that came and was no reading, counted by kind.
        on_rows: called with every batch of new readings.
        on_bytes: called with host time and bytes, before anything has looked at them.
    """

    quantity: str
    unit: str
    calibration: Calibration | None
    columns: dict[str, str]
    rate_hz: float
    identity: dict[str, str]
    rows: int
    faults: Faults
    on_rows: list[Callable[[Rows], None]]
    on_bytes: Callable[[int, bytes], None] | None

    @property
    def name(self) -> str:
        """Device and port, for messages."""
        ...

    @property
    def last_problem(self) -> str:
        """Words of the last fault."""
        ...

    @property
    def midway(self) -> bool:
        """Whether a message has begun to come that is not yet counted."""
        ...

    def connect(self, serial: str) -> dict[str, str]:
        """Check who it is, where it can report that, and that readings come.

        Raises:
            DeviceError, DeviceTimeout: another serial number, or no reading.
        """
        ...

    def poll(self) -> None:
        """Read what came; called in every round of the event loop."""
        ...

    def finish(self) -> None:
        """Nothing more is waited for: half a message is counted as such."""
        ...

    def recent(self, n: int) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.bool_]]:
        """The newest ``n`` readings as they came: (readings, whether at rest)."""
        ...

    def apply(self, reading: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Readings in ``quantity``."""
        ...

    def mean(self, n: int) -> float:
        """Mean of the newest ``n`` readings in ``quantity``; nan before the first."""
        ...

    def next_mean(self, n: int) -> float:
        """Mean of the next ``n`` readings in ``quantity``.

        Raises:
            DeviceTimeout: they did not come.
        """
        ...

    def counters(self) -> dict[str, int]:
        """Rows and faults by kind."""
        ...


class Actuator(Protocol):
    """Sets one quantity and confirms it."""

    @property
    def name(self) -> str:
        """Device and port, for messages."""
        ...

    def set_value(self, value: float) -> float:
        """Set the quantity, wait until it is set; returns what the device or a sensor reports.

        Raises:
            DeviceError: outside the limits, refused, or not confirmed.
        """
        ...
