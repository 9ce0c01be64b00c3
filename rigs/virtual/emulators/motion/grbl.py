"""A linear stage at byte level: the part of GRBL 1.1 that a length axis uses."""

from __future__ import annotations

import re

from rigs.rigfile.tables.stage import StageDevice
from rigs.virtual.emulators.emulator import Emulator, Send
from rigs.virtual.emulators.motion.axis import SetMotion, StageEmulator

_WORD = re.compile(r"([A-Z])(-?\d+(?:\.\d*)?)")


class VirtualGrbl(StageEmulator):
    """Moves the muscle's end at constant speed; position is the muscle's length in mm.

    Args:
        set_motion: called with (length_mm, rate_mm_s) when a move starts or ends.
        send: takes the bytes that go to the host.
        serial: what $I answers.
        start_mm: position at power-up.
        low_mm, high_mm: soft limits; a target beyond them is refused (error:15).

    Attributes:
        comma: True prints decimal commas.
        inches: True reports positions in inches, as after $13=1.
        wire: injects faults.
    """

    def __init__(
        self,
        set_motion: SetMotion,
        send: Send,
        serial: str,
        start_mm: float,
        low_mm: float,
        high_mm: float,
    ) -> None:
        super().__init__(set_motion, send, start_mm)
        self.comma = self.inches = False
        self._serial = serial
        self._low, self._high = low_mm, high_mm
        self._feed_mm_min = 600.0
        self._buffer = bytearray()
        self._send_line("Grbl 1.1h ['$' for help]")

    def restart(self) -> None:
        """A brown-out: it stops where it is and greets as after power-up."""
        self._halt()
        self._send_line("Grbl 1.1h ['$' for help]")

    def feed(self, data: bytes) -> None:
        """Bytes from the host; ``?`` and the reset byte act at once, as in GRBL."""
        for byte in data:
            if byte == ord("?"):
                self._status()
            elif byte == 0x18:
                self._halt()
                self._buffer.clear()
                self._send_line("Grbl 1.1h ['$' for help]")
            elif byte in b"\r\n":
                line = self._buffer.decode("ascii", "replace").strip()
                self._buffer.clear()
                if line:
                    self._line(line)
            elif len(self._buffer) < 128:
                self._buffer.append(byte)

    def _send_line(self, line: str) -> None:
        self.wire.send(line.encode("ascii") + b"\r\n", self._now_ns)

    def _where(self) -> float:
        return self._axis.where_mm()

    def _status(self) -> None:
        state = "Run" if self._axis.moving else "Idle"
        where = f"{self._where():.3f},0.000,0.000"
        if self.inches:
            where = f"{self._where() / 25.4:.4f},0.0000,0.0000"
        if self.comma:
            where = where.replace(".", ",")
        self._send_line(f"<{state}|MPos:{where}|FS:{abs(self._axis.rate_mm_s) * 60:.0f},0>")

    def _halt(self) -> None:
        self._axis.halt()

    def _line(self, line: str) -> None:
        if line == "$I":
            self._send_line(f"[VER:1.1h.20190825:{self._serial}]")
            self._send_line("ok")
            return
        words = dict(_WORD.findall(line.upper()))
        if "F" in words:
            self._feed_mm_min = float(words["F"])
        if "X" in words:
            target = float(words["X"])
            if not self._low <= target <= self._high:
                self._send_line("error:15")
                return
            self._axis.move(target, self._feed_mm_min / 60.0)
        elif "G" not in words:
            self._send_line("error:20")
            return
        self._send_line("ok")


def emulator(
    device: StageDevice,
    limits_mm: tuple[float, float],
    start_mm: float,
    set_motion: SetMotion,
    send: Send,
) -> Emulator:
    """The stage of a virtual bench."""
    return VirtualGrbl(set_motion, send, device.serial, start_mm, *limits_mm)
