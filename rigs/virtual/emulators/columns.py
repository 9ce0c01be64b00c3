"""Somebody's Arduino at byte level: prints columns at a steady rate, and takes a set-point.

A muscle held at one length stands behind it: its pressure follows the set-point with a time
constant, its force follows equation 4-7 of the thesis.
"""

from __future__ import annotations

import contextlib
import math

from daq.clock import VirtualClock
from daq.errors import LinkLost
from daq.link.transport import Link
from rigs.rigfile.columns import ColumnForm
from rigs.virtual.emulators.emulator import Send
from rigs.virtual.emulators.injected_fault import Wire

BRAID_MM, TURNS, LENGTH_MM = 88.4, 1.855, 62.0
FILL_S = 0.15
SLOW_PPM = 180.0
"""Its resonator is slower than the computer's clock by this much, as ceramic ones are."""
START_MS = 4_000_000
SILENCE_NS = 2_000_000_000
"""As the example sketch: without a line for so long it sets 0."""
SEPARATOR = {",": ",", ";": ";", "\t": "\t", " ": " "}


class VirtualColumns:
    """Prints one line each period.

    Attributes:
        set_kpa: the last set-point that came.
        mute: True prints nothing; ``deaf`` takes no set-point.
        comma: True prints decimal commas.
        jump_ms: added to its time, as after a restart where negative.
        wire: injects faults, and collects bytes as an adapter does (``bunch_ns``).
    """

    def __init__(self, form: ColumnForm, send: Send) -> None:
        self._form = form
        self.wire = Wire(send)
        self.wire.bunch_ns = 0
        self.set_kpa = self.kpa = 0.0
        self.mute = self.deaf = self.comma = False
        self.jump_ms = 0
        self._buffer = b""
        self._now_ns = 0
        self._period_ns = round(1e9 / form.rate_hz * (1.0 + SLOW_PPM * 1e-6))
        self._next_ns = self._period_ns
        self._heard_ns: int | None = None

    @property
    def next_ns(self) -> int | None:
        """When it prints next, or the wire delivers."""
        held = self.wire.next_ns
        return self._next_ns if held is None else min(held, self._next_ns)

    def feed(self, data: bytes) -> None:
        """Bytes from the host: ``P=250.0``."""
        *lines, self._buffer = (self._buffer + data).split(b"\n")
        for raw in lines:
            line = raw.decode("ascii", "replace").strip()
            if not self.deaf and line.startswith("P="):
                self.set_kpa = float(line[2:])
                self._heard_ns = self._now_ns
                self._print(f"# P={self.set_kpa:.1f}")

    def _print(self, text: str) -> None:
        if self._form.checksum:
            total = 0
            for character in text:
                total ^= ord(character)
            text = f"{text}*{total:02X}"
        self.wire.send(text.encode("ascii") + b"\r\n", self._now_ns)

    def truth(self) -> dict[str, float]:
        """What it would print now, in the quantities' units."""
        area_mm2 = (3.0 * LENGTH_MM**2 - BRAID_MM**2) / (4.0 * math.pi * TURNS**2)
        return {
            "pressure_kpa": self.kpa,
            "force_n": self.kpa * 1e-3 * area_mm2,
            "length_mm": LENGTH_MM,
            "temperature_c": 21.0,
        }

    def _line(self) -> str:
        unit = {"s": 1e-3, "ms": 1.0, "us": 1e3}[self._form.time_unit]
        own_ms = self._now_ns * 1e-6 / (1.0 + SLOW_PPM * 1e-6) + START_MS + self.jump_ms
        truth = self.truth()
        cells = []
        for name in self._form.columns:
            if name == "time":
                own = own_ms * unit
                cells.append(f"{own:.3f}" if self._form.time_unit == "s" else str(round(own)))
                continue
            calibration = self._form.calibrations[name]
            cells.append(f"{(truth[name] - calibration.offset) / calibration.scale:.3f}")
        if self.comma:
            cells = [cell.replace(".", ",") for cell in cells]
        return SEPARATOR[self._form.delimiter].join(cells)

    def advance(self, to_ns: int) -> None:
        """Let time pass to ``to_ns``."""
        passed_s = (to_ns - self._now_ns) * 1e-9
        self.kpa += (self.set_kpa - self.kpa) * (1.0 - math.exp(-passed_s / FILL_S))
        self._now_ns = to_ns
        if self._heard_ns is not None and to_ns - self._heard_ns > SILENCE_NS:
            self._heard_ns, self.set_kpa = None, 0.0
            self._print("# P=0.0")
        if to_ns >= self._next_ns:
            self._next_ns += self._period_ns
            if not self.mute:
                self._print(self._line())
        self.wire.advance(to_ns)


def join_columns(form: ColumnForm, end: Link, clock: VirtualClock) -> VirtualColumns:
    """Hang such a device onto a virtual clock, at the far end of a link; returns the device."""

    def send(data: bytes) -> None:
        with contextlib.suppress(LinkLost):  # a device does not notice a pulled cable
            end.write(data)

    device = VirtualColumns(form, send)
    device.wire.bunch_ns = 16_000_000  # a USB adapter's latency timer

    def advance(until_ns: int) -> None:
        with contextlib.suppress(LinkLost):
            for chunk in end.read():
                device.feed(chunk.data)
        while clock.now_ns() < until_ns:
            due = device.next_ns
            stop = until_ns if due is None else min(until_ns, max(due, clock.now_ns() + 1))
            clock.set_now_ns(stop)
            device.advance(stop)

    clock.on_advance(advance)
    return device
