"""A data acquisition card: scans by its own clock, each channel an instrument of the rig.

The card converts at the times of its own oscillator. The host sees blocks of scans, each some time
after its last scan was made. The clock of the card is the lower edge of these times against the
number of scans (`daq.link.loweredge`).
"""

from __future__ import annotations

from collections import deque
from typing import Protocol

import numpy as np
import numpy.typing as npt

from daq.clock import NS_PER_S
from daq.errors import DeviceError, LinkLost
from daq.link.loweredge import lower_edge
from rigs.devices.event_loop import EventLoop
from rigs.devices.instruments.carried import CarriedReadings
from rigs.rigfile.form import Parsed
from rigs.rigfile.instruments import CardChannel, CardDevice

Block = npt.NDArray[np.float64]
FULL = 0.999
"""Of its range: a voltage beyond is an overload."""
CONNECT_S = 3.0
SILENT_S = 1.0
BUCKETS = 60
BUCKET_NS = 500_000_000
LEAST_BUCKETS = 6


class Backend(Protocol):
    """What is needed of a manufacturer's package; `labjack` and `ni` are the two that there are."""

    lost: float
    """The voltage that stands for a scan that the card could not keep; nan where there is none."""

    def open(self) -> dict[str, str]:
        """Open the card; serial number and type. Raises `DeviceError`."""
        ...

    def start(self, channels: list[CardChannel], rate_hz: float) -> float:
        """Start scanning; returns the rate that the card makes of it. Raises `DeviceError`."""
        ...

    def read(self) -> Block:
        """Scans that are there, shape (n, channels), in V; n may be 0. Raises `LinkLost`."""
        ...

    def write(self, terminal: str, volts: float) -> None:
        """Set an analogue output. Raises `LinkLost`."""
        ...

    def close(self) -> None:
        """Stop scanning and let the card go."""
        ...


class ScanClock:
    """Host time of each scan."""

    def __init__(self, rate_hz: float) -> None:
        self._period_ns = NS_PER_S / rate_hz
        self._points: deque[tuple[int, int]] = deque(maxlen=BUCKETS)
        self._bucket_ns = 0
        self._line = (0.0, 0.0)
        self._last_ns = 0

    def add(self, scans: int, now_ns: int) -> None:
        """The last of so many scans had been made by now."""
        late = now_ns - scans * self._period_ns
        newest = self._points[-1] if self._points else None
        if newest is None or now_ns - self._bucket_ns >= BUCKET_NS:
            self._bucket_ns = now_ns
            self._points.append((scans, now_ns))
        elif late < newest[1] - newest[0] * self._period_ns:
            self._points[-1] = (scans, now_ns)
        else:
            return
        at = np.array([p[0] for p in self._points], dtype=np.float64)
        excess = np.array([p[1] - p[0] * self._period_ns - self._bucket_ns for p in self._points])
        if len(at) < LEAST_BUCKETS:
            self._line = (float(excess.min()) + self._bucket_ns, 0.0)
        else:
            begin, slope = lower_edge(at - at[-1], excess)
            self._line = (begin + self._bucket_ns - slope * at[-1], slope)

    def stamps(self, first: int, n: int) -> npt.NDArray[np.int64]:
        """Host times of scans, ns, ascending, shape (n,)."""
        k = np.arange(first, first + n, dtype=np.float64)
        made = np.round(self._line[0] + k * (self._period_ns + self._line[1])).astype(np.int64)
        made = np.maximum.accumulate(np.maximum(made, self._last_ns + 1 + np.arange(n)))
        if n:
            self._last_ns = int(made[-1])
        return made


class CardReader(CarriedReadings):
    """One channel as an `Instrument` (`rigs.devices.interfaces`); its readings are in V."""

    def __init__(self, card: Card, name: str, channel: CardChannel) -> None:
        super().__init__(
            channel.form.quantity, "V", channel.calibration, event_loop=card.event_loop,
            rate_hz=card.device.rate_hz, advice="check the card's driver and its channel",
        )  # fmt: skip
        self._card = card
        self._channel = channel
        self.key = name

    @property
    def name(self) -> str:
        """Which channel of which card."""
        return f"{self.key} ({self._channel.terminal} of {self._card.name})"

    def connect(self, serial: str) -> dict[str, str]:
        """Check that readings come; the card checks its serial number.

        Raises:
            DeviceTimeout: none came.
        """
        del serial
        self.identity = {**self._card.identity, "terminal": self._channel.terminal}
        self._first(CONNECT_S)
        return self.identity

    def poll(self) -> None:
        """The card reads all channels at once."""
        self._card.poll()

    def take(self, ns: npt.NDArray[np.int64], volts: Block, lost: float) -> None:
        """Scans of this channel, each shape (n,); an overload is no row."""
        for at_ns, value in zip(ns.tolist(), volts.tolist(), strict=True):
            if value == lost or value != value:
                self._take(at_ns, Parsed("damaged", detail="the card could not keep a scan"))
            elif abs(value) >= FULL * self._channel.range_v:
                self._take(at_ns, Parsed("overload", detail=f"{value:.3f} V"))
            else:
                self._take(at_ns, Parsed("", value))
        self._hand_on()


class Card:
    """An opened card.

    Args:
        backend: the manufacturer's package.
        device: its table of the rig file.
        event_loop: of the bench.

    Raises:
        DeviceError: another serial number, or the package refuses.
    """

    def __init__(self, backend: Backend, device: CardDevice, event_loop: EventLoop) -> None:
        self._backend = backend
        self.device = device
        self.event_loop = event_loop
        self.identity = backend.open()
        got = self.identity.get("serial", "")
        if device.serial and got != device.serial:
            backend.close()
            raise DeviceError(
                self.name, f"key card.serial: expected {device.serial}, got {got}",
                "connect the right card, or change card.serial in the rig file",
            )  # fmt: skip
        self.readers = {n: CardReader(self, n, channel) for n, channel in device.channels.items()}
        self._scans = 0
        self._lost = False
        rate_hz = backend.start(list(device.channels.values()), device.rate_hz)
        self._clock = ScanClock(rate_hz)
        self._heard_ns = event_loop.clock.now_ns()
        self._silent = False
        event_loop.add(self.poll)

    @property
    def name(self) -> str:
        """Kind and port, for messages."""
        return f"card {self.device.kind} on {self.device.port}"

    def poll(self) -> None:
        """Read what is there and hand it to the channels.

        Raises:
            LinkLost: once, when the package reports that the card is gone.
        """
        if self._lost:
            return
        try:
            block = self._backend.read()
        except LinkLost as error:
            self._lost = True
            for reader in self.readers.values():
                reader.faults.add("unplugged", error.what)
            raise
        now_ns = self.event_loop.clock.now_ns()
        if not len(block):
            if not self._silent and now_ns - self._heard_ns > SILENT_S * NS_PER_S:
                self._silent = True
                for reader in self.readers.values():
                    reader.faults.add("silent", f"for {SILENT_S:g} s")
            return
        self._heard_ns, self._silent = now_ns, False
        self._clock.add(self._scans + len(block), now_ns)
        ns = self._clock.stamps(self._scans + 1, len(block))
        self._scans += len(block)
        for k, reader in enumerate(self.readers.values()):
            reader.take(ns, block[:, k], self._backend.lost)

    def write(self, terminal: str, volts: float) -> None:
        """Set an analogue output."""
        self._backend.write(terminal, volts)

    def close(self) -> None:
        """Stop scanning and let the card go."""
        self._backend.close()
