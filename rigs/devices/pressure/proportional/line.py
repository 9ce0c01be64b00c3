"""The serial line of a proportional regulator: polled for its own reading, set in between.

The reading of the regulator is an instrument's reading as any other (`PortInstrument`): it is
recorded as a stream of its own and is never the pressure of a test. A set-point is sent on a quiet
line. Its answer is held for a moment, and a second one in that time makes both worthless. A
set-point counts only when it was read back.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from daq.errors import DeviceError, DeviceTimeout, LinkLost, PamrigError
from daq.link.framer import LineFramer
from daq.link.transport import Chunk, Link
from rigs.devices.event_loop import EventLoop
from rigs.devices.instruments.instrument import PortInstrument
from rigs.devices.pressure.behind_valves import BehindValves
from rigs.devices.pressure.source import PressureCommand, PressureSource
from rigs.rigfile.form import Parsed
from rigs.rigfile.tables.regulator import MonitorForm

TRIES = 3
SECOND_S = 0.03
"""An answer is held this long in case a second one comes."""
IDLE_S = 2.5
"""A line that is not quiet after so long is out of order."""
LOW_KPA = 20.0
"""A vented muscle is joined to a regulator that reads less: no step of the pressure, no jump."""
LOW_S = 5.0
"""A regulator that has not come down after so long cannot: one without an exhaust of its own."""


@dataclass(frozen=True)
class Answer(Parsed):
    """A line of a regulator.

    Attributes:
        set_point: the set-point in it, in the regulator's unit; None where it has none.
    """

    set_point: float | None = None


class RegulatorLine(PortInstrument):
    """A regulator behind a port; a subclass knows its bytes and implements :meth:`set_kpa`.

    Args:
        link, event_loop: of the bench.
        form: quantity, unit, rate and time-out of its own reading.
        end: what ends a line.

    Attributes:
        sent_ns: host time at which the newest set-point was written.
        set_kpa_now: the set-point that was read back last, kPa; None before the first.
    """

    def __init__(
        self, link: Link, event_loop: EventLoop, form: MonitorForm, end: bytes = b"\r\n"
    ) -> None:
        super().__init__(link, event_loop, "pressure_source", form, polled=True)
        self.form = form
        self.sent_ns = 0
        self.set_kpa_now: float | None = None
        self._framer = LineFramer(end[-1:])
        self._answers: list[Answer] = []
        self._listing: list[str] | None = None
        self._wanted = False

    # ---- what a subclass knows --------------------------------------------------------

    def _line(self, text: str) -> Answer | None:
        """What a line is; None for one that answers the sentinel."""
        raise NotImplementedError

    def set_kpa(self, pressure_kpa: float, tries: int = TRIES) -> float:
        """Set the pressure; returns what the regulator reports as set, in kPa.

        Raises:
            DeviceError: refused, not answered, or another set-point is reported.
            LinkLost: the link is gone.
        """
        raise NotImplementedError

    def rounded(self, pressure_kpa: float) -> float:
        """The set-point nearest to a pressure that the regulator can be given, kPa."""
        raise NotImplementedError

    @property
    def step_kpa(self) -> float:
        """Distance of two set-points next to each other, kPa."""
        raise NotImplementedError

    # ---- lines ------------------------------------------------------------------------

    def _partial(self) -> bool:
        return bool(self._framer.partial)

    def _drop_partial(self) -> int:
        return self._framer.discard()

    def _decode(self, chunk: Chunk) -> Iterator[Parsed | None]:
        for text, wrong in self._framer.texts(chunk.data):
            if wrong:
                yield Answer("damaged", detail=wrong)
                continue
            if self._listing is not None:
                self._listing.append(text.strip())
            else:
                yield self._line(text)

    def _item(self, item: Parsed | None, host_ns: int) -> None:
        if self._state == "setting" and isinstance(item, Answer):
            self._answers.append(item)
        else:
            super()._item(item, host_ns)

    def _ask_reading(self, now_ns: int) -> None:
        if not self._wanted:
            super()._ask_reading(now_ns)

    # ---- requests ---------------------------------------------------------------------

    def _exchange(
        self, data: bytes, good: Callable[[Answer], bool], tries: int, wanted: str
    ) -> Answer:
        """The one whole answer to a command, asked for up to ``tries`` times.

        Raises:
            DeviceError: no such answer; names the last fault.
            LinkLost: the link is gone.
        """
        self._wanted = True
        try:
            for _ in range(tries):
                self._quiet(IDLE_S)
                if self._drop_partial():
                    self.faults.add("half")
                self._state, self._answers = "setting", []
                self.sent_ns = self._event_loop.clock.now_ns()
                self._write(data)
                timeout_s = self._timeout_ns * 1e-9
                self._event_loop.until(lambda: bool(self._answers), timeout_s)
                self._event_loop.for_seconds(SECOND_S)
                answers, self._answers = self._answers, []
                if len(answers) == 1 and not answers[0].fault and good(answers[0]):
                    self._state = "idle"
                    return answers[0]
                self._complain(answers)
                self._drain(self._event_loop.clock.now_ns(), timed_out=not answers)
        finally:
            self._wanted = False
            if self._state == "setting":
                self._state = "idle"
        raise DeviceError(
            self.name, f"{wanted}, no good answer in {tries} tries", self.faults.last or "see cable"
        )

    def _complain(self, answers: list[Answer]) -> None:
        if not answers:
            half = self._drop_partial()
            self.faults.add("half", f"{half} bytes") if half else self.faults.add("no_answer")
        elif len(answers) > 1:
            self.faults.add("stale", "; ".join(a.detail for a in answers))
        elif answers[0].fault:
            self.faults.add(answers[0].fault, answers[0].detail)
        else:
            self.faults.add("unset", answers[0].detail)

    def _quiet(self, seconds: float) -> None:
        """Wait until nothing is on its way.

        Raises:
            LinkLost: the link is gone.
            DeviceTimeout: the line does not become quiet.
        """
        if self._link is None:
            raise LinkLost(self.name, "the link is lost", "check cable and power")
        if not self._event_loop.until(lambda: self._state == "idle", seconds):
            raise DeviceTimeout(
                self.name, "its line does not become quiet", self.faults.last or "check the cable"
            )

    def _list(self, data: bytes, silent_s: float = 0.25) -> list[str]:
        """The lines that answer a question, up to a silence. Only before the polling begins."""
        found: list[str] = []
        self._listing = found
        try:
            self._drop_partial()
            if data:
                self._write(data)
            count = -1
            while count != len(found):
                count = len(found)
                self._event_loop.for_seconds(silent_s)
                self.poll_line()
        finally:
            self._listing = None
        return found

    def wait_low(self) -> None:
        """Set to 0 already: wait until its own reading is low, `LOW_S` at most."""
        first = self.rows
        self._event_loop.until(lambda: self.rows > first and self.mean(1) < LOW_KPA, LOW_S)

    def let_down(self) -> None:
        """Set the pressure to 0, once and without a long wait: the muscle is vented already."""
        with contextlib.suppress(PamrigError):
            self.set_kpa(0.0, tries=1)

    def poll_line(self) -> None:
        """Read what came, and send nothing."""
        if self._link is None:
            return
        for chunk in self._link.read():
            if self.on_bytes is not None:
                self.on_bytes(chunk.host_ns, chunk.data)
            for _ in self._decode(chunk):
                pass


class ProportionalSource(BehindValves):
    """A serial proportional regulator upstream of the inlet valve that the controller keeps.

    Args:
        valves: the controller as a pressure source.
        line: the regulator.
        accuracy_kpa: how far its pressure may rest from the set-point.
    """

    def __init__(self, valves: PressureSource, line: RegulatorLine, accuracy_kpa: float) -> None:
        super().__init__(valves)
        self._line = line
        self.own_device = line
        self.accuracy_kpa = accuracy_kpa

    @property
    def name(self) -> str:
        """Regulator and port."""
        return self._line.name

    @property
    def identity(self) -> dict[str, str]:
        """What the regulator reports about itself."""
        return self._line.identity

    @property
    def sent_ns(self) -> int:
        """Host time at which the newest set-point was written."""
        return self._line.sent_ns

    @property
    def step_kpa(self) -> float:
        """Distance of two set-points next to each other, kPa."""
        return self._line.step_kpa

    def command(self, pressure_kpa: float) -> PressureCommand:
        """The set-point, and the nearest one that the regulator can be given."""
        self.limits.check(pressure_kpa)
        own = {"regulator_kpa": self._line.rounded(pressure_kpa)}
        return PressureCommand("pressure_source", pressure_kpa, own)

    def prepare(self, pressure_kpa: float) -> None:
        """Join a vented muscle to the regulator while that is at 0; both rise together then.

        Air that waited behind the inlet would come in as a jump, which the firmware takes for a
        broken sensor.

        Raises:
            DeviceError, LinkLost: the regulator does not take a set-point of 0.
        """
        if not self._valves.vented:
            return
        self._valves.keep_alive(LOW_S + IDLE_S)
        if self._line.set_kpa_now != 0.0:
            self._line.set_kpa(0.0)
        self._line.wait_low()
        self._valves.set_pressure(pressure_kpa)

    def set_pressure(self, pressure_kpa: float) -> PressureCommand:
        """Set the regulator, read its set-point back, then open the inlet.

        In this order: a regulator that still stands at an older, higher set-point is not let in.
        """
        command = self.command(pressure_kpa)
        self.prepare(pressure_kpa)
        self._line.set_kpa(pressure_kpa)
        self._valves.set_pressure(pressure_kpa)
        return command

    def vent(self) -> None:
        """The controller vents; then the regulator is set to 0, so that the next rise begins there.

        Raises:
            DeviceError, LinkLost: the regulator does not take it; the muscle is vented.
        """
        self._valves.vent()
        self._line.set_kpa(0.0)

    def ramp_to(self, pressure_kpa: float) -> None:
        """The regulator alone follows."""
        self._line.set_kpa(max(pressure_kpa, 0.0))

    def stop(self) -> None:
        """The controller vents first; then the regulator is set to 0, if it can be reached."""
        self._valves.stop()
        self._line.let_down()
