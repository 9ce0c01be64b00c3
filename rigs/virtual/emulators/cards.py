"""Mocks of the manufacturers' packages: the functions that the drivers use, with a simulated card.

They are made from the packages' own signatures (labjack-ljm 1.23, nidaqmx 1.7), not from the
drivers. No card and no simulated device of a manufacturer stands behind them.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, Protocol

from rigs.rigfile.instruments import CardDevice

FAST_PPM = 40.0
"""The card's oscillator is faster than the bench's clock by this much."""
WAIT_S, WAITS = 0.001, 1000
DEVICE_SCANS = 4000
"""Scans that the card keeps for the host."""


class VirtualCard:
    """Scans its inputs by its own clock from the start on.

    Args:
        device: of the rig file.
        read: gives the voltage at a terminal now.
        set_volts: takes the voltage of an output.
        sleep: lets the bench's time pass while a function of a package waits.

    Attributes:
        skip: so many scans are lost next.
        begun_ns: bench time of the start.
        gone: True: the cable is pulled.
        mute: True: no scan comes.
    """

    def __init__(
        self,
        device: CardDevice,
        read: dict[str, Callable[[], float]],
        set_volts: Callable[[str, float], None],
        sleep: Callable[[float], None],
    ) -> None:
        self.sleep = sleep
        self.device = device
        self._read = read
        self._set_volts = set_volts
        self._period_ns = 0.0
        self._next: float | None = None
        self._now_ns = 0
        self.terminals: list[str] = []
        self.ranges: dict[str, float] = {}
        self.scans: deque[list[float]] = deque(maxlen=DEVICE_SCANS)
        self.skip = self.begun_ns = 0
        self.gone = self.mute = False

    def start(self, rate_hz: float) -> None:
        """Begin to scan."""
        self._period_ns = 1e9 / rate_hz / (1.0 + FAST_PPM * 1e-6)
        self.begun_ns = self._now_ns
        self._next = self._now_ns + self._period_ns

    def stop(self) -> None:
        """Scan no more."""
        self._next = None

    def write(self, terminal: str, volts: float) -> None:
        """An analogue output."""
        self._set_volts(terminal, volts)

    def feed(self, data: bytes) -> None:
        """It has no byte port."""

    @property
    def next_ns(self) -> int | None:
        """When it scans next."""
        return None if self._next is None else round(self._next)

    def advance(self, to_ns: int) -> None:
        """Let time pass to ``to_ns``."""
        self._now_ns = to_ns
        if self._next is None or round(self._next) > to_ns:
            return
        self._next += self._period_ns
        if self.mute:
            return
        self.scans.append([self._clipped(terminal) for terminal in self.terminals])

    def _clipped(self, terminal: str) -> float:
        most = self.ranges.get(terminal, 10.0)
        return max(-most, min(most, self._read[terminal]()))


class SimulatedCard(Protocol):
    """What the mocks need of a card: that of this process, or one behind a port."""

    device: CardDevice
    terminals: list[str]
    ranges: dict[str, float]
    skip: int
    sleep: Callable[[float], None]

    @property
    def gone(self) -> bool:
        """The cable is pulled."""
        ...

    @property
    def scans(self) -> deque[list[float]]:
        """Scans that can be read."""
        ...

    def start(self, rate_hz: float) -> None:
        """Begin to scan."""
        ...

    def stop(self) -> None:
        """Scan no more."""
        ...

    def write(self, terminal: str, volts: float) -> None:
        """An analogue output."""
        ...


class LJMError(Exception):
    """As the package's."""


class VirtualLjm:
    """The functions of ``labjack.ljm`` that the driver uses, with their arguments and results."""

    LJMError = LJMError

    def __init__(self, card: SimulatedCard) -> None:
        self._card = card
        self._per_read = 1

    def _check(self) -> None:
        if self._card.gone:
            raise LJMError("LJM library error code 1239 LJME_RECONNECT_FAILED")

    def openS(self, deviceType: str = "ANY", connectionType: str = "ANY",
              identifier: str = "ANY") -> int:  # fmt: skip
        """Handle."""
        self._check()
        return 1

    def getHandleInfo(self, handle: int) -> tuple[int, int, int, int, int, int]:
        """Device type, connection, serial number, address, port, bytes a packet."""
        return 7, 1, int(self._card.device.serial or 0), 0, 0, 64

    def namesToAddresses(self, numFrames: int, aNames: list[str]) -> tuple[list[int], list[int]]:
        """Modbus addresses and types: AIN0 is 0, AIN1 is 2."""
        self._card.terminals = list(aNames)
        return [2 * int(name.removeprefix("AIN")) for name in aNames], [3] * numFrames

    def eWriteName(self, handle: int, name: str, value: float) -> None:
        """A register."""
        self._check()
        if name.endswith("_RANGE"):
            self._card.ranges[name.removesuffix("_RANGE")] = value
        else:
            self._card.write(name, value)

    def eStreamStart(
        self, handle: int, scansPerRead: int, numAddresses: int,
        aScanList: list[int], scanRate: float,
    ) -> float:  # fmt: skip
        """The actual rate."""
        self._check()
        self._per_read = scansPerRead
        self._card.start(scanRate)
        return scanRate

    def eStreamRead(self, handle: int) -> tuple[list[float], int, int]:
        """Interleaved data and the scans left in both buffers; waits for a whole block."""
        self._check()
        card = self._card
        scans = card.scans
        for _ in range(WAITS):
            if len(scans) >= self._per_read or card.gone:
                break
            card.sleep(WAIT_S)
            scans = card.scans
        self._check()
        if len(scans) < self._per_read:
            raise LJMError("LJM library error code 1301 LJME_NO_SCANS_RETURNED")
        data: list[float] = []
        for _ in range(self._per_read):
            scan = scans.popleft()
            if card.skip:
                card.skip -= 1
                scan = [-9999.0] * len(scan)
            data += scan
        return data, 0, len(scans)

    def eStreamStop(self, handle: int) -> None:
        """Stop."""
        self._card.stop()

    def close(self, handle: int) -> None:
        """Let the device go."""


class DaqError(Exception):
    """As the package's ``nidaqmx.errors.Error``."""


class _InStream:
    def __init__(self, card: SimulatedCard) -> None:
        self._card = card

    @property
    def avail_samp_per_chan(self) -> int:
        """Scans that can be read."""
        if self._card.gone:
            raise DaqError("Status Code: -200324\nDevice was unplugged")
        return len(self._card.scans)


class VirtualTask:
    """``nidaqmx.Task`` as far as the driver uses it."""

    def __init__(self, card: SimulatedCard) -> None:
        self._card = card
        self._rate = 0.0
        self._output = ""
        self.ai_channels = SimpleNamespace(add_ai_voltage_chan=self._input)
        self.ao_channels = SimpleNamespace(add_ao_voltage_chan=self._out)
        self.timing = SimpleNamespace(cfg_samp_clk_timing=self._clocked, samp_clk_rate=0.0)
        self.in_stream = _InStream(card)

    def _input(self, physical: str, *, min_val: float, max_val: float) -> None:
        del min_val
        terminal = physical.rpartition("/")[2]
        self._card.terminals.append(terminal)
        self._card.ranges[terminal] = max_val

    def _out(self, physical: str, *, min_val: float, max_val: float) -> None:
        del min_val, max_val
        self._output = physical.rpartition("/")[2]

    def _clocked(self, rate: float, *, sample_mode: Any, samps_per_chan: int) -> None:
        del sample_mode, samps_per_chan
        self.timing.samp_clk_rate = self._rate = rate

    def start(self) -> None:
        """Begin."""
        self._card.start(self._rate)

    def read(self, number_of_samples_per_channel: int) -> list[float] | list[list[float]]:
        """A list of samples for one channel, a list of lists for several."""
        scans = self._card.scans
        rows = [scans.popleft() for _ in range(number_of_samples_per_channel)]
        columns = [list(column) for column in zip(*rows, strict=True)]
        return columns[0] if len(columns) == 1 else columns

    def write(self, data: float) -> int:
        """One sample to the output."""
        if self._card.gone:
            raise DaqError("Status Code: -200324\nDevice was unplugged")
        self._card.write(self._output, data)
        return 1

    def close(self) -> None:
        """End."""
        if not self._output:
            self._card.stop()


def nidaqmx_of(card: SimulatedCard) -> Any:
    """The module ``nidaqmx`` as far as the driver uses it."""
    serial = int(card.device.serial or "0", 16)
    device = SimpleNamespace(serial_num=serial, product_type="USB-6211")
    return SimpleNamespace(
        Task=lambda: VirtualTask(card),
        system=SimpleNamespace(Device=lambda name: device),
        errors=SimpleNamespace(Error=DaqError),
        constants=SimpleNamespace(AcquisitionType=SimpleNamespace(CONTINUOUS=10123)),
    )


def library_of(card: SimulatedCard) -> Any:
    """The stand-in of the package that the rig file's card needs."""
    return VirtualLjm(card) if card.device.kind == "labjack" else nidaqmx_of(card)
