"""Driver of a bench supply that speaks SCPI: the voltage of the valve's solenoids.

SCPI answers do not name their question either, but IEEE 488.2 gives every instrument a register
that one may write and read back (``*ESE``): after anything odd a fresh number is sent through
it, and whatever comes before that number is thrown away.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from daq.errors import DeviceError, DeviceTimeout, LinkLost, PamrigError
from daq.link.transport import Link
from rigs.devices.event_loop import Pump
from rigs.devices.lines import LineDevice

NUMBER = re.compile(r"[-+]?\d+(\.\d+)?(E[-+]?\d+)?", re.IGNORECASE)
FLAG = 9.9e37
"""SCPI's number for "cannot tell you": overload; negative for underload, 9.91E37 for none."""
TRIES = 3
ANSWER_S = 0.5
REOPEN_S = 5.0
CONFIRM_V = 0.002
COLUMNS = {
    "row": "int64",
    "host_ns": "int64",
    "set_v": "float64",
    "voltage_v": "float64",
    "current_a": "float64",
    "output": "uint8",
}
UNITS = {"host_ns": "ns", "set_v": "V", "voltage_v": "V", "current_a": "A"}


class Supply(LineDevice):
    """A bench supply whose voltage is set, confirmed and measured.

    Args:
        link, pump: bytes and waiting.
        voltage_v: what the solenoids normally get; :meth:`safe` goes back to it.
        max_v: never asked for more.
        settle_v: how far the measured voltage may be from the set one.
        reopen: opens the port anew when it was lost; None makes a loss final.
    """

    def __init__(
        self,
        link: Link,
        pump: Pump,
        voltage_v: float,
        max_v: float,
        *,
        settle_v: float = 0.05,
        reopen: Callable[[], Link] | None = None,
    ) -> None:
        super().__init__(link, pump, "supply", end=b"\n")
        self.voltage_v = voltage_v
        self.max_v = max_v
        self.settle_v = settle_v
        self.identity: dict[str, str] = {}
        self.rows = 0
        self.set_v = 0.0
        self.is_on = False
        self.on_rows: list[Callable[[dict[str, npt.NDArray[np.generic]]], None]] = []
        self._reopen = reopen
        self._serial = ""
        self._nonce = 0
        self._gone = False
        self._restoring = False

    def poll(self) -> None:
        """Read what came; a lost link is counted and found again at the next command."""
        if self._gone:
            return
        try:
            super().poll()
        except LinkLost:
            self._gone = True

    def connect(self, serial: str) -> dict[str, str]:
        """Clear it, ask who it is and put the line in order.

        Raises:
            DeviceError: another serial number than the rig file names.
        """
        self._serial = serial
        self._resync()
        answer = self._query("*IDN?", re.compile(r"[^,]*,[^,]*,[^,]*,.*"))
        maker, model, got, firmware = (word.strip() for word in answer.split(",", 3))
        self.identity = {"serial": got, "maker": maker, "model": model, "firmware": firmware}
        if serial and got != serial:
            raise DeviceError(
                self.name,
                f"key supply.serial: expected {serial}, got {got}",
                "connect the right supply, or change supply.serial in the rig file",
            )
        return self.identity

    def set_voltage(self, voltage_v: float) -> float:
        """Set the voltage; returns what the supply says it is set to.

        Raises:
            DeviceError: beyond ``max_v``, refused, or not what was asked for.
        """
        if not 0.0 <= voltage_v <= self.max_v:
            raise DeviceError(
                self.name,
                f"{voltage_v:g} V is outside 0 to {self.max_v:g} V (key supply.max_v)",
                "correct the protocol or the limit",
            )
        self._command(f"VOLT {voltage_v:.3f}")
        got = self._number("VOLT?")
        if abs(got - voltage_v) > CONFIRM_V:
            self.faults.add("unset", f"told {voltage_v:.3f} V, says {got:.3f} V")
            raise DeviceError(
                self.name, f"was told {voltage_v:.3f} V, is set to {got:.3f} V", "see its limits"
            )
        self.set_v = got
        return got

    def output(self, on: bool) -> None:
        """Switch the output, and read back that it is.

        Raises:
            DeviceError: the output is not as it was told to be.
        """
        self._command(f"OUTP {'ON' if on else 'OFF'}")
        said = self._query("OUTP?", re.compile(r"0|1|ON|OFF"))
        if (said in ("1", "ON")) != on:
            self.faults.add("unset", f"told to go {'on' if on else 'off'}, says {said}")
            raise DeviceError(
                self.name,
                f"its output was told to go {'on' if on else 'off'} and is {said}",
                "look for a tripped protection on its front",
            )
        self.is_on = on

    def measure(self) -> tuple[float, float]:
        """Measured (voltage in V, current in A); also a row for the record.

        Raises:
            DeviceError: no answer that reads, three times over.
        """
        volts = self._number("MEAS:VOLT?")
        amps = self._number("MEAS:CURR?")
        batch: dict[str, npt.NDArray[Any]] = {
            name: np.array([value], dtype=dtype)
            for (name, dtype), value in zip(
                COLUMNS.items(),
                (self.rows, self._pump.clock.now_ns(), self.set_v, volts, amps, self.is_on),
                strict=True,
            )
        }
        self.rows += 1
        for listener in self.on_rows:
            listener(batch)
        return volts, amps

    def safe(self) -> None:
        """Back to the solenoids' normal voltage, on: so that they do what they are told.

        It is switched on even where it does not confirm its voltage.
        """
        try:
            self.set_voltage(self.voltage_v)
        finally:
            self.output(True)

    # ---- the line ---------------------------------------------------------------------

    def _command(self, text: str) -> None:
        """A command that answers nothing; its error queue says whether it was taken."""
        for _ in range(TRIES):
            if self._say(text):
                break
        error_text = self._query("SYST:ERR?", re.compile(r'[-+]?\d+,".*"'))
        if int(error_text.split(",")[0]) != 0:
            self.faults.add("refused", error_text)
            raise DeviceError(self.name, f"refused {text!r}: {error_text}", "see its manual")

    def _number(self, query: str) -> float:
        value = float(self._query(query, NUMBER))
        if abs(value) >= FLAG:
            kind = "overload" if value > 0 else "underload"
            self.faults.add(kind, f"{query} gave {value:g}")
            raise DeviceError(
                self.name, f"{query} gave {value:g}: out of its range", "check range and wiring"
            )
        return value

    def _query(self, text: str, pattern: re.Pattern[str]) -> str:
        """The one whole answer to a question.

        Anything else (half, doubled, late, stale, with a comma) is counted, the line is put
        in order, and the question is asked again.
        """
        for _ in range(TRIES):
            self._restore()
            self._lines.clear()
            if self._framer.discard():
                self.faults.add("half")
            if not self._say(text):
                continue
            self._pump.until(lambda: bool(self._lines), ANSWER_S)
            self._pump.for_seconds(0.03)  # a second answer makes both worthless
            lines = list(self._lines)
            if len(lines) == 1 and pattern.fullmatch(lines[0]):
                return lines[0]
            self._complain(lines, pattern)
            self._resync()
        raise DeviceError(
            self.name, f"no good answer to {text!r} in {TRIES} tries", self.faults.last
        )

    def _complain(self, lines: list[str], pattern: re.Pattern[str]) -> None:
        if self._gone:
            return
        if not lines:
            half = self._framer.partial
            self.faults.add("half", repr(half)) if half else self.faults.add("no_answer")
        elif len(lines) > 1:
            self.faults.add("stale", repr(lines))
        elif pattern.fullmatch(lines[0].replace(",", ".")):
            self.faults.add("comma", repr(lines[0]))
        else:
            self.faults.add("damaged", repr(lines[0]))

    def _resync(self) -> None:
        """Throw away everything that is older than a number sent now."""
        for _ in range(TRIES):
            self._nonce = self._nonce % 250 + 1
            expected = str(self._nonce)
            self._framer.discard()
            if not (self._say(f"*ESE {self._nonce}") and self._say("*ESE?")):
                continue

            def came(expected: str = expected) -> bool:
                while self._lines:
                    line = self._lines.popleft()
                    if line.lstrip("+") == expected:
                        return True
                    self.faults.add("late", repr(line))
                return self._gone

            if self._pump.until(came, 4 * ANSWER_S) and not self._gone:
                return
        raise DeviceTimeout(
            self.name, "does not answer *ESE?", "check port, cable, baud rate and power"
        )

    def _say(self, text: str) -> bool:
        """Send a line, over a port found again if need be; False when it was lost just now."""
        self._restore()
        try:
            self.send(text)
        except LinkLost:
            self._gone = True
        return not self._gone

    def _restore(self) -> None:
        """Find a lost port again; who answers must be who was there before.

        Raises:
            LinkLost: it did not come back.
        """
        if not self._gone:
            return
        reopen = self._reopen
        if reopen is None or self._restoring:
            raise LinkLost(self.name, "the link is lost", "check cable and power")

        def found() -> bool:
            try:
                self._link = reopen()
            except PamrigError:
                return False
            return True

        if not self._pump.until(found, REOPEN_S):
            raise LinkLost(
                self.name, f"was unplugged, and not back in {REOPEN_S:g} s", "plug it in again"
            )
        self._gone = self._lost = False
        self._framer.discard()
        self._lines.clear()
        self.faults.add("replugged")
        self._restoring = True
        try:
            if self.identity:
                self.connect(self._serial or self.identity["serial"])
        finally:
            self._restoring = False

    def counters(self) -> dict[str, int]:
        """Rows and faults by kind."""
        return {"rows": self.rows, **self.faults.counts}
