"""A stage on a Marlin 2 board at byte level: numbered lines, a queue, M114 and M400."""

from __future__ import annotations

from collections import deque
from functools import reduce

from rigs.rigfile.tables.stage import StageDevice
from rigs.virtual.emulators.emulator import Emulator, Send
from rigs.virtual.emulators.motion.axis import SetMotion, StageEmulator

STEPS_PER_MM = 80.0
BUSY_NS = 2_000_000_000
"""The board reports that it is busy this often while a command makes it wait."""


class VirtualMarlin(StageEmulator):
    """Axis X of a printer board that moves the muscle's end.

    A target beyond the software end stops is shortened to them without a word, as Marlin does.

    Attributes:
        waits: M114 waits for the end of the move, as Marlin 1.1 does.
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
        self.waits = False
        self._serial = serial
        self._low, self._high = low_mm, high_mm
        self._planned = start_mm
        self._shift = 0.0
        self._feed_mm_s = 10.0
        self._last = 0
        self._buffer = b""
        self._queue: deque[str] = deque()
        self._busy_ns: int | None = None

    def restart(self) -> None:
        """A brown-out: it stops, and calls the place where it is zero."""
        self._axis.halt()
        self._queue.clear()
        self._busy_ns = None
        self._last, self._planned = 0, 0.0
        self._shift = self._axis.where_mm()
        self._say("start")
        self._say("echo:Marlin 2.1.2.1")

    def hit(self) -> None:
        """The carriage runs into an end stop: the rest of the move is dropped."""
        self._axis.halt()
        self._planned = self._axis.where_mm() - self._shift
        self._say(f"echo:endstops hit:  X:{self._planned:.2f}")
        self._take()

    def feed(self, data: bytes) -> None:
        """Bytes from the host."""
        *lines, self._buffer = (self._buffer + data).split(b"\n")
        for raw in lines:
            text = raw.decode("ascii", "replace").strip()
            if text and self._numbered(text):
                self._queue.append(self._body(text))
        self._take()

    def _say(self, line: str) -> None:
        self.wire.send(line.encode("ascii") + b"\n", self._now_ns)

    @staticmethod
    def _body(text: str) -> str:
        if text[0] != "N":
            return text
        return text.split("*")[0].partition(" ")[2]

    def _numbered(self, text: str) -> bool:
        """Check number and checksum of a line; False after a request to send it again."""
        if text[0] != "N":
            return True
        body, star, given = text.partition("*")
        total = reduce(lambda a, b: a ^ ord(b), body, 0)
        if not star or given != str(total):
            return self._resend("checksum mismatch")
        number = int(body[1:].split(" ")[0])
        if number != self._last + 1 and "M110" not in body:
            return self._resend("Line Number is not Last Line Number+1")
        self._last = number
        return True

    def _resend(self, why: str) -> bool:
        self._say(f"Error:{why}, Last Line: {self._last}")
        self._say(f"Resend: {self._last + 1}")
        self._say("ok")
        return False

    @property
    def _due_ns(self) -> int | None:
        return self._busy_ns

    def _work(self) -> None:
        if self._busy_ns is not None and self._busy_ns <= self._now_ns:
            self._busy_ns += BUSY_NS
            self._say("echo:busy: processing")
        self._take()

    def _take(self) -> None:
        while self._queue:
            code = self._queue[0].split(" ")[0]
            if self._axis.moving and (code in ("G1", "M400") or (code == "M114" and self.waits)):
                if self._busy_ns is None:
                    self._busy_ns = self._now_ns + BUSY_NS
                return
            self._busy_ns = None
            self._do(self._queue.popleft())

    def _do(self, text: str) -> None:
        code, *words = text.split(" ")
        if code == "G1":
            self._go({word[0]: float(word[1:]) for word in words})
        elif code == "M114":
            steps = round((self._axis.where_mm() - self._shift) * STEPS_PER_MM)
            self._say(f"X:{self._planned:.2f} Y:0.00 Z:0.00 E:0.00 Count X:{steps} Y:0 Z:0")
        elif code == "M115":
            self._say(
                "FIRMWARE_NAME:Marlin 2.1.2.1 (Feb 20 2023 10:21:16) SOURCE_CODE_URL:"
                "github.com/MarlinFirmware/Marlin PROTOCOL_VERSION:1.0 MACHINE_TYPE:Stage "
                f"EXTRUDER_COUNT:0 UUID:{self._serial}"
            )
            self._say("Cap:EEPROM:1")
        elif code == "M503":
            self._say("echo:; Linear Units:")
            self._say("echo:  G21 ; (mm)")
            self._say(f"echo:  M92 X{STEPS_PER_MM:.2f} Y80.00 Z400.00 E500.00")
        elif code not in ("G21", "G90", "M17", "M84", "M110", "M400"):
            self._say(f'echo:Unknown command: "{text}"')
        self._say("ok")

    def _go(self, words: dict[str, float]) -> None:
        self._feed_mm_s = words.get("F", self._feed_mm_s * 60.0) / 60.0
        if "X" in words:
            target = min(max(words["X"] + self._shift, self._low), self._high)
            self._planned = target - self._shift
            self._axis.move(round(target * STEPS_PER_MM) / STEPS_PER_MM, self._feed_mm_s)


def emulator(
    device: StageDevice,
    limits_mm: tuple[float, float],
    start_mm: float,
    set_motion: SetMotion,
    send: Send,
) -> Emulator:
    """The stage of a virtual bench."""
    return VirtualMarlin(set_motion, send, device.serial, start_mm, *limits_mm)
