"""Driver of any line-based instrument that is set, by its description: no code of its own.

An answer does not name its question. So each question is put on a quiet line, a second answer
makes both worthless, and after anything odd the line is put in order: a fresh number is written
to the instrument and read back (the description's ``sync_set``), and whatever comes before that
number is thrown away. A setting counts only when it was read back.
"""

from __future__ import annotations

import re
from collections.abc import Callable

from daq.errors import DeviceError, DeviceTimeout, LinkLost, PamrigError
from daq.link.transport import Link
from rigs.devices.event_loop import EventLoop
from rigs.devices.lines import LineDevice
from rigs.rigfile.command_form import CommandForm, SetForm

TRIES = 3
REOPEN_S = 5.0
SECOND_S = 0.03
"""An answer is held this long in case a second one comes."""
QUIET_TIMEOUTS = 4


class CommandedInstrument(LineDevice):
    """An instrument that is set, read back and measured by the lines of its description.

    Args:
        link, event_loop: of the bench.
        kind: its table in the rig file.
        form: the description.
        reopen: opens the port anew when it was lost; None makes a loss final.
    """

    def __init__(
        self,
        link: Link,
        event_loop: EventLoop,
        kind: str,
        form: CommandForm,
        *,
        reopen: Callable[[], Link] | None = None,
    ) -> None:
        super().__init__(link, event_loop, kind, end=form.end)
        self.form = form
        self.identity: dict[str, str] = {}
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
        """Put the line in order and check who it is, where it can report that.

        Raises:
            DeviceError: another serial number than the rig file names.
        """
        self._serial = serial
        self._resync()
        if not self.form.identify:
            self.identity = {"serial": serial, "identity": "not verifiable"}
            return self.identity
        answer = self._query(self.form.identify, self.form.identify_pattern)
        match = self.form.identify_pattern.fullmatch(answer)
        assert match is not None
        found = {key: (value or "").strip() for key, value in match.groupdict().items()}
        self.identity = {"serial": found.pop("serial"), **found}
        if serial and self.identity["serial"] != serial:
            raise DeviceError(
                self.name,
                f"key {self.kind}.serial: expected {serial}, got {self.identity['serial']}",
                f"connect the right device, or change {self.kind}.serial in the rig file",
            )
        return self.identity

    def set(self, name: str, value: float) -> float:
        """Set a quantity of the description; returns what the instrument reports as set.

        Raises:
            DeviceError: outside the limits, refused, or not what was requested.
        """
        form = self.form.settings[name]
        if not form.low <= value <= form.high:
            raise DeviceError(
                self.name,
                f"{value:g} {form.unit} is outside {form.low:g} to {form.high:g} {form.unit}"
                f" ({name})",
                "correct the protocol or the limit",
            )
        if form.reply is not None:
            self._query(form.line(value), form.reply)
        else:
            self._command(form.line(value))
        return self._confirm(form, value) if form.read_back else value

    def get(self, name: str) -> float:
        """Measure a quantity of the description.

        Raises:
            DeviceError: no answer that reads, three times over, or out of its range.
        """
        form = self.form.queries[name]
        match = form.pattern.fullmatch(self._query(form.query, form.pattern))
        assert match is not None
        return self._in_range(form.query, float(match["value"]))

    def _confirm(self, form: SetForm, value: float) -> float:
        answer = self._query(form.read_back, form.pattern)
        got = self._in_range(form.read_back, form.read(answer))
        if abs(got - value) > form.tolerance:
            wanted, found = form.shown(value), answer if form.words else form.shown(got)
            self.faults.add("unset", f"commanded {wanted}, reports {found}")
            raise DeviceError(
                self.name,
                f"was commanded {wanted}, is {'' if form.words else 'set to '}{found}",
                form.remedy,
            )
        return got

    def _in_range(self, query: str, value: float) -> float:
        if abs(value) >= self.form.overload:
            kind = "overload" if value > 0 else "underload"
            self.faults.add(kind, f"{query} gave {value:g}")
            raise DeviceError(
                self.name, f"{query} gave {value:g}: out of its range", "check range and wiring"
            )
        return value

    # ---- the line ---------------------------------------------------------------------

    def _command(self, text: str) -> None:
        """A command that answers nothing; its error queue says whether it was taken."""
        for _ in range(TRIES):
            if self._write_line(text):
                break
        if not self.form.error_query:
            return
        answer = self._query(self.form.error_query, self.form.error_pattern)
        match = self.form.error_pattern.fullmatch(answer)
        assert match is not None
        if int(match["code"]) != 0:
            self.faults.add("refused", answer)
            raise DeviceError(self.name, f"refused {text!r}: {answer}", "see its manual")

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
            if not self._write_line(text):
                continue
            self._event_loop.until(lambda: bool(self._lines), self.form.timeout_s)
            self._event_loop.for_seconds(SECOND_S)  # a second answer makes both worthless
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
        form = self.form
        if not form.sync_set:
            self._event_loop.for_seconds(QUIET_TIMEOUTS * form.timeout_s)
            self._framer.discard()
            self._lines.clear()
            return
        for _ in range(TRIES):
            self._nonce = self._nonce % 250 + 1
            expected = str(self._nonce)
            self._framer.discard()
            if not (
                self._write_line(form.sync_set.format(number=self._nonce))
                and self._write_line(form.sync_query)
            ):
                continue

            def came(expected: str = expected) -> bool:
                while self._lines:
                    line = self._lines.popleft()
                    if line.lstrip("+") == expected:
                        return True
                    self.faults.add("late", repr(line))
                return self._gone

            if self._event_loop.until(came, QUIET_TIMEOUTS * form.timeout_s) and not self._gone:
                return
        raise DeviceTimeout(
            self.name,
            f"does not answer {form.sync_query}",
            "check port, cable, baud rate and power",
        )

    def _write_line(self, text: str) -> bool:
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

        if not self._event_loop.until(found, REOPEN_S):
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


class Setting:
    """One quantity of such an instrument, as an `Actuator`."""

    def __init__(self, device: CommandedInstrument, quantity: str) -> None:
        self._device = device
        self._quantity = quantity

    @property
    def name(self) -> str:
        """The instrument's."""
        return self._device.name

    def set_value(self, value: float) -> float:
        """See :meth:`CommandedInstrument.set`."""
        return self._device.set(self._quantity, value)
