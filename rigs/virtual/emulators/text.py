"""Any line-based instrument at byte level, made from the same description as its driver."""

from __future__ import annotations

import re
from collections.abc import Callable

from rigs.rigfile.form import TextForm
from rigs.virtual.emulators.emulator import Send
from rigs.virtual.emulators.injected_fault import Wire

READY_NS = 2_000_000
"""A polled instrument answers after this."""


class VirtualText:
    """Prints readings of a simulated quantity, by itself or on request.

    Args:
        form: the description; its ``template`` (or the example) tells how a line looks.
        read: the reading now, in the instrument's unit.
        send: takes the bytes that go to the host.
        serial: what it reports on the identity request.
        rate_hz: of an instrument that sends by itself.

    Attributes:
        unit: unit set on the keypad.
        comma: True prints decimal commas.
        flag: "overload" or "underload" prints that instead of a reading.
        wire: injects faults.
        mute: True sends nothing.
    """

    def __init__(
        self,
        form: TextForm,
        read: Callable[[], float],
        send: Send,
        serial: str,
        rate_hz: float = 0.0,
    ) -> None:
        self._form = form
        self._read = read
        self._serial = serial
        self._buffer = bytearray()
        self._period_ns = round(1e9 / (rate_hz or form.rate_hz))
        self._now_ns = 0
        self._due: list[tuple[int, bytes]] = []
        self._next_ns = self._period_ns
        self._tare = 0.0
        self._last = 0.0
        self.unit = form.unit
        self.comma = False
        self.flag = ""
        self.mute = False
        self.wire = Wire(send)

    def feed(self, data: bytes) -> None:
        """Bytes from the host."""
        self._buffer += data
        end = self._form.end[-1:]
        while (at := self._buffer.find(end)) >= 0:
            line = self._buffer[:at].decode("ascii", "replace").strip()
            del self._buffer[: at + 1]
            self._command(line)
        del self._buffer[:-256]

    def _command(self, line: str) -> None:
        form = self._form
        if not line:
            return
        if form.query and line == form.query.strip():
            self._due.append((self._now_ns + READY_NS, b"reading"))
        elif form.identify and line == form.identify.strip():
            self._due.append((self._now_ns + READY_NS, b"who"))
        elif form.tare and line == form.tare.strip():
            self._tare += self._reading()

    def _reading(self) -> float:
        return self._read() - self._tare

    def line(self) -> str:
        """The line that it prints now."""
        form = self._form
        flag = {"overload": form.overload, "underload": form.underload}.get(self.flag)
        if flag is not None:
            return re.sub(r"\\(.)", r"\1", flag.pattern)
        value = self._reading()
        still = abs(value - self._last) * 1e9 / self._period_ns < 1.0 or not form.stable
        self._last = value
        text = (form.template or "{value:.3f}").format(
            value=value,
            unit=self.unit,
            status=form.stable if still else "US",
        )
        return text.replace(".", ",") if self.comma else text

    def _who(self) -> bytes:
        pattern = self._form.identify_pattern
        words = pattern.pattern if pattern is not None else ""
        text = re.sub(r"\(\?P<serial>[^)]*\)", self._serial, words)
        return re.sub(r"\\(.)", r"\1", text).encode("ascii") + self._form.end

    @property
    def next_ns(self) -> int | None:
        """When it next has something to do."""
        times = [t for t, _ in self._due]
        if not self._form.query:
            times.append(self._next_ns)
        if self.wire.next_ns is not None:
            times.append(self.wire.next_ns)
        return min(times) if times else None

    def advance(self, to_ns: int) -> None:
        """Let time pass to ``to_ns`` (bench time)."""
        self._now_ns = to_ns
        for due in [d for d in self._due if d[0] <= to_ns]:
            self._due.remove(due)
            if due[1] == b"who":
                if not self.mute:
                    self.wire.send(self._who(), to_ns)
            else:
                self._send_reading(to_ns)
        while not self._form.query and self._next_ns <= to_ns:
            self._next_ns += self._period_ns
            self._send_reading(to_ns)
        self.wire.advance(to_ns)

    def _send_reading(self, now_ns: int) -> None:
        if not self.mute:
            self.wire.send(self._form.seal(self.line()), now_ns)
