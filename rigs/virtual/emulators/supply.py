"""A SCPI bench supply at byte level."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from rigs.virtual.emulators.emulator import Send
from rigs.virtual.emulators.injected_fault import Wire

READY_NS = 3_000_000


class VirtualSupply:
    """Sets and measures the voltage of the solenoids.

    Args:
        send: takes the bytes that go to the host.
        serial: in ``*IDN?``.
        max_v: beyond it a voltage is refused (-222).
        noise_v: called for the error of a measurement, in V.
        load_ohm: what hangs on it.

    Attributes:
        volts: at its terminals now.
        comma: True prints decimal commas.
        flag: "overload" or "underload" is answered to a measurement.
        suffix: what somebody switched on at the keypad to be printed behind numbers.
        wire: injects faults.
    """

    def __init__(
        self,
        send: Send,
        serial: str,
        max_v: float = 30.0,
        noise_v: Callable[[], float] = lambda: 0.0,
        load_ohm: float = 50.0,
    ) -> None:
        self._serial = serial
        self._max_v = max_v
        self._noise_v = noise_v
        self._load_ohm = load_ohm
        self._buffer = bytearray()
        self._now_ns = 0
        self._due: deque[tuple[int, str]] = deque()
        self._errors: deque[str] = deque(maxlen=20)
        self._ese = 0
        self.set_v = 0.0
        self.is_on = False
        self.comma = False
        self.flag = ""
        self.suffix = ""
        self.mute = False
        self.wire = Wire(send)

    @property
    def volts(self) -> float:
        """At its terminals now."""
        return self.set_v if self.is_on else 0.0

    def feed(self, data: bytes) -> None:
        """Bytes from the host."""
        self._buffer += data
        while (at := self._buffer.find(b"\n")) >= 0:
            line = self._buffer[:at].decode("ascii", "replace").strip()
            del self._buffer[: at + 1]
            if line:
                self._command(line)
        del self._buffer[:-256]

    def _command(self, line: str) -> None:
        word, _, argument = line.partition(" ")
        answer = self._answer(word.upper(), argument.strip())
        if answer is not None:
            self._due.append((self._now_ns + READY_NS, answer))

    def _answer(self, word: str, argument: str) -> str | None:
        match word:
            case "*IDN?":
                return f"PAMRIG,BENCH SUPPLY,{self._serial},1.0"
            case "*ESE?":
                return str(self._ese)
            case "SYST:ERR?":
                return self._errors.popleft() if self._errors else '0,"No error"'
            case "VOLT?":
                return self._number(self.set_v)
            case "OUTP?":
                return "1" if self.is_on else "0"
            case "MEAS:VOLT?":
                return self._number(self.volts + self._noise_v())
            case "MEAS:CURR?":
                return self._number(self.volts / self._load_ohm)
            case "*ESE" | "VOLT" | "OUTP" | "*CLS":
                self._set(word, argument)
                return None
        self._errors.append('-113,"Undefined header"')
        return None

    def _set(self, word: str, argument: str) -> None:
        try:
            if word == "*ESE":
                self._ese = int(argument) & 255
            elif word == "*CLS":
                self._errors.clear()
            elif word == "OUTP":
                self.is_on = {"ON": True, "1": True, "OFF": False, "0": False}[argument.upper()]
            else:
                volts = float(argument)
                if not 0.0 <= volts <= self._max_v:
                    self._errors.append('-222,"Data out of range"')
                    return
                self.set_v = volts
        except (ValueError, KeyError):
            self._errors.append('-224,"Illegal parameter value"')

    def _number(self, value: float) -> str:
        value = {"overload": 9.9e37, "underload": -9.9e37}.get(self.flag, value)
        text = f"{value:+.6E}" + self.suffix
        return text.replace(".", ",") if self.comma else text

    @property
    def next_ns(self) -> int | None:
        """When it next has something to do."""
        times = [self._due[0][0]] if self._due else []
        if self.wire.next_ns is not None:
            times.append(self.wire.next_ns)
        return min(times) if times else None

    def advance(self, to_ns: int) -> None:
        """Let time pass to ``to_ns`` (bench time)."""
        self._now_ns = to_ns
        while self._due and self._due[0][0] <= to_ns:
            _, answer = self._due.popleft()
            if not self.mute:
                self.wire.send(answer.encode("ascii") + b"\n", to_ns)
        self.wire.advance(to_ns)
