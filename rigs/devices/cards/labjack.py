"""LabJack T-series by the package ``labjack-ljm`` (functions of the LJM library)."""

from __future__ import annotations

from typing import Any

import numpy as np

from daq.clock import NS_PER_S, Clock
from daq.errors import DeviceError, LinkLost
from rigs.devices.cards.card import Block
from rigs.rigfile.instruments import CardChannel

READS_HZ = 50.0
"""``eStreamRead`` waits for its scans, so it is called when they are due."""
SKIPPED = -9999.0
"""What LJM puts in the place of a scan that the device could not keep."""


class LabJack:
    """One T4, T7 or T8.

    Args:
        ljm: the module ``labjack.ljm``, or a stand-in with the same functions.
        port: identifier: serial number, IP address, name, or ANY.
        clock: of the bench.
    """

    lost = SKIPPED

    def __init__(self, ljm: Any, port: str, clock: Clock) -> None:
        self._ljm = ljm
        self._port = port
        self._clock = clock
        self._handle: Any = None
        self._columns = self._per_read = 1
        self._period_ns = self._due_ns = 0.0
        self._streaming = False

    def open(self) -> dict[str, str]:
        """See `Backend`."""
        try:
            self._handle = self._ljm.openS("ANY", "ANY", self._port)
            info = self._ljm.getHandleInfo(self._handle)
        except self._ljm.LJMError as error:
            raise DeviceError(
                f"LabJack {self._port}", str(error), "check cable and Kipling"
            ) from None
        return {"serial": str(info[2]), "type": f"LabJack T{info[0]}"}

    def start(self, channels: list[CardChannel], rate_hz: float) -> float:
        """See `Backend`."""
        names = [channel.terminal for channel in channels]
        self._columns, self._per_read = len(names), max(1, round(rate_hz / READS_HZ))
        try:
            for channel in channels:
                self._ljm.eWriteName(self._handle, f"{channel.terminal}_RANGE", channel.range_v)
            addresses = self._ljm.namesToAddresses(len(names), names)[0]
            actual = float(
                self._ljm.eStreamStart(self._handle, self._per_read, len(names), addresses, rate_hz)
            )
        except self._ljm.LJMError as error:
            raise DeviceError(f"LabJack {self._port}", str(error), "check card.channels") from None
        self._streaming = True
        self._period_ns = self._per_read / actual * NS_PER_S
        self._due_ns = self._clock.now_ns() + self._period_ns
        return actual

    def read(self) -> Block:
        """See `Backend`; waits for at most the rest of one block."""
        blocks = []
        while self._clock.now_ns() >= self._due_ns:
            try:
                data, _, backlog = self._ljm.eStreamRead(self._handle)
            except self._ljm.LJMError as error:
                raise LinkLost(f"LabJack {self._port}", str(error), "check cable") from None
            blocks.append(np.array(data, dtype=np.float64).reshape(-1, self._columns))
            self._due_ns += self._period_ns
            if backlog < self._per_read:
                # As many as are there are read; the next block is due a block later.
                self._due_ns = max(self._due_ns, float(self._clock.now_ns()))
                break
        return np.concatenate(blocks) if blocks else np.zeros((0, self._columns))

    def write(self, terminal: str, volts: float) -> None:
        """See `Backend`."""
        try:
            self._ljm.eWriteName(self._handle, terminal, volts)
        except self._ljm.LJMError as error:
            raise LinkLost(f"LabJack {self._port}", str(error), "check cable") from None

    def close(self) -> None:
        """See `Backend`."""
        try:
            if self._streaming:
                self._ljm.eStreamStop(self._handle)
            self._ljm.close(self._handle)
        except self._ljm.LJMError:
            pass  # it is gone already
