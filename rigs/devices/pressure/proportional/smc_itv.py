"""SMC ITV electro-pneumatic regulators with RS-232C (ITV..-RC).

9600 baud, 8 data bits, no parity; lines end with CR LF. Pressures are counts, 0 to 1023 over the
regulator's range: ``SET 512`` sets and answers the count, ``REQ`` answers the set count, ``MON``
the count of its own sensor; ``INC`` and ``DEC`` move the set-point by one and are not used here.
A command that it does not know, and a count above 1023, are answered by words. Source: published
programs that drive one; no manual of SMC was at hand. Whether a count comes with leading zeros is
not certain, so 1 to 4 digits are taken.

It has no identity, and a count does not say which question it answers. So a count that was set is
asked for again, and after anything odd the line must be silent for four time-outs.
"""

from __future__ import annotations

import re

from daq.link.transport import Link
from rigs.devices.event_loop import EventLoop
from rigs.devices.pressure.proportional.line import (
    TRIES,
    Answer,
    ProportionalSource,
    RegulatorLine,
)
from rigs.devices.pressure.regulator_output import RegulatorOutput
from rigs.devices.pressure.source import PressureSource, SourceParts
from rigs.rigfile.tables.regulator import MonitorForm, check_reach, read_monitor

TOP = 1023
COUNT = re.compile(r"\d{1,4}")
WORDS = re.compile(r"[A-Z][A-Z ]{4,}")


class ItvLine(RegulatorLine):
    """One regulator on a port of its own.

    Args:
        link, event_loop, form: see `RegulatorLine`.
        full_kpa: pressure at count 1023.
    """

    def __init__(
        self, link: Link, event_loop: EventLoop, form: MonitorForm, full_kpa: float
    ) -> None:
        super().__init__(link, event_loop, form)
        self._per_count = full_kpa / TOP

    def _query(self) -> bytes:
        return b"MON\r\n"

    @property
    def step_kpa(self) -> float:
        """One count."""
        return self._per_count

    def rounded(self, pressure_kpa: float) -> float:
        """To the nearest count."""
        return self._count(pressure_kpa) * self._per_count

    def _count(self, pressure_kpa: float) -> int:
        return min(max(round(pressure_kpa / self._per_count), 0), TOP)

    def _line(self, text: str) -> Answer:
        word = text.strip()
        if WORDS.fullmatch(word):
            return Answer("refused", detail=repr(text))
        if not COUNT.fullmatch(word):
            return Answer("damaged", detail=repr(text))
        count = int(word)
        if count > TOP:
            return Answer("range", detail=repr(text))
        kpa = count * self._per_count
        return Answer("", kpa, True, repr(text), kpa)

    def set_kpa(self, pressure_kpa: float, tries: int = TRIES) -> float:
        """See :meth:`RegulatorLine.set_kpa`: set, then asked for again."""
        count = self._count(pressure_kpa)
        wanted = count * self._per_count

        def good(answer: Answer) -> bool:
            return (
                answer.set_point is not None and round(answer.set_point / self._per_count) == count
            )

        self.set_kpa_now = None
        what = f"set to {wanted:.2f} kPa"
        self._exchange(f"SET {count}\r\n".encode(), good, tries, what)
        sent_ns = self.sent_ns
        self._exchange(b"REQ\r\n", good, tries, what)
        self.sent_ns, self.set_kpa_now = sent_ns, wanted
        return wanted


def open_source(parts: SourceParts) -> PressureSource:
    """The source ``smc-itv`` of a rig file."""
    settings = parts.config.pressure_source
    table = settings.table()
    monitor = read_monitor(table)
    table.finish()
    check_reach(settings.file, parts.config.limits.pressure_kpa, monitor.full_kpa)
    line = ItvLine(parts.open_link(), parts.event_loop, monitor.form, monitor.full_kpa)
    line.connect(settings.serial)
    return ProportionalSource(
        RegulatorOutput(parts.valve, parts.config), line, monitor.accuracy_kpa
    )
