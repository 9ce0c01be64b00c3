"""Alicat PC and PCD pressure controllers by their ASCII protocol.

Commands and answers end with a carriage return; a command begins with the letter of the unit.
``A`` alone asks for the data frame: letter, numbers of a fixed width, status codes. ``A??M*`` lists
who it is, ``A??D*`` which number of the frame is what and in which unit. ``AS12.34`` sets; the
answer is a data frame with the set-point in it. ``@@=A`` ends a stream of frames, ``AC`` ends a
hold of the valves. Source: Alicat, Serial Communications Primer, 2023, and the manual of the
pressure controllers.

Every frame repeats the set-point. One that was not sent here (front panel, another program) ends
the test.
"""

from __future__ import annotations

import re

from daq.errors import DeviceError, DeviceTimeout
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
from rigs.rigfile.form import Parsed
from rigs.rigfile.tables.regulator import MonitorForm, check_reach, read_monitor

GAUGE = {"psig": 6.894757293168, "kpag": 1.0, "barg": 100.0, "mbarg": 0.1, "mpag": 1000.0,
         "hpag": 0.1, "pag": 0.001}  # fmt: skip
"""kPa in a unit of gauge pressure, written in small letters."""
INFO = re.compile(r"(?P<unit>[A-Z]) +M(?P<code>\d\d) *(?P<text>.*)")
FIELD = re.compile(
    r"(?P<unit>[A-Z]) +D\d\d +\d{2,3} +(?P<name>.+?) +(?:s )?decimal +(?P<width>\d)/(?P<digits>\d)"
    r" +\d+ +\d+ +(?P<label>\S+)"
)
"""A number of the frame in the answer to ``??D*``."""
HOLDS = ("HLD", "EXH")
BEYOND = {"POV": "overload", "OPL": "overload", "ADC": "damaged"}
HARMLESS = ("LCK", "TOV", "TMF", "VOV", "MOV", "OVR")


class AlicatLine(RegulatorLine):
    """One controller on a port of its own.

    Args:
        link, event_loop, form: see `RegulatorLine`.
        unit: its letter.
    """

    def __init__(self, link: Link, event_loop: EventLoop, form: MonitorForm, unit: str) -> None:
        super().__init__(link, event_loop, form, end=b"\r")
        self._unit = unit
        self._kpa = 1.0
        self._digits = 2
        self._width = 7
        self._numbers = 2
        self._at = (0, 1)
        self._told = False

    def _query(self) -> bytes:
        return self._unit.encode() + b"\r"

    @property
    def step_kpa(self) -> float:
        """The last digit of the frame."""
        return float(10.0**-self._digits * self._kpa)

    def rounded(self, pressure_kpa: float) -> float:
        """To the digits of the frame."""
        return float(f"{pressure_kpa / self._kpa:.{self._digits}f}") * self._kpa

    # ---- who it is ----------------------------------------------------------------------

    def connect(self, serial: str) -> dict[str, str]:
        """End a stream, check who it is and in which unit it reads, then begin to poll.

        Raises:
            DeviceTimeout: it does not answer; names what did.
            DeviceError: another serial number, or a frame without gauge pressure and set-point.
        """
        self._list(f"@@={self._unit}\r".encode())
        info = {m["code"]: m["text"] for m in self._described("??M*", INFO)}
        found = info.get("05", "").removeprefix("Serial Number").strip()
        model = info.get("04", "").removeprefix("Model Number").strip()
        firmware = info.get("09", "").removeprefix("Software Revision").strip()
        self.identity.update(serial=found, model=model, firmware=firmware)
        if serial and found != serial:
            raise DeviceError(
                self.name,
                f"key {self.key}.serial: expected {serial}, got {found or 'none'}",
                f"connect the right device, or change {self.key}.serial in the rig file",
            )
        self._learn(self._described("??D*", FIELD))
        self._list(f"{self._unit}C\r".encode())
        return super().connect(serial)

    def _described(self, question: str, pattern: re.Pattern[str]) -> list[re.Match[str]]:
        """The lines that answer a question about itself, of this unit alone."""
        lines: list[str] = []
        for _ in range(TRIES):
            lines = self._list(f"{self._unit}{question}\r".encode())
            found = [m for line in lines if (m := pattern.fullmatch(line)) is not None]
            if any(m["unit"] != self._unit for m in found):
                self.faults.add("stranger", lines[0])
            elif found:
                return found
        raise DeviceTimeout(
            self.name,
            f"no answer to {self._unit}{question}" + (f"; got {lines[0]!r}" if lines else ""),
            f"check port, cable, baud rate and unit letter (key {self.key}.unit)",
        )

    def _learn(self, fields: list[re.Match[str]]) -> None:
        """Where pressure and set-point stand in the frame."""
        names = [m["name"].lower() for m in fields]
        sets = [k for k, name in enumerate(names) if "set" in name and "press" in name]
        reads = [k for k, name in enumerate(names) if "press" in name and k not in sets]
        labels = {fields[k]["label"] for k in sets + reads}
        if len(sets) != 1 or len(reads) != 1 or len(labels) != 1:
            raise DeviceError(
                self.name,
                f"its data frame has {', '.join(m['name'].strip() for m in fields)}",
                "one pressure and its set-point in one unit are needed; set them at its panel",
            )
        label = labels.pop()
        if label.lower() not in GAUGE:
            raise DeviceError(
                self.name,
                f"reads in {label}; gauge pressure is needed ({', '.join(GAUGE)})",
                "choose the unit at its panel",
            )
        self._kpa = GAUGE[label.lower()]
        pressure = fields[reads[0]]
        self._width, self._digits = int(pressure["width"]), int(pressure["digits"])
        self._numbers = len(fields)
        self._at = (reads[0], sets[0])

    # ---- frames -------------------------------------------------------------------------

    def _line(self, text: str) -> Answer:
        if text.strip() == "?":
            return Answer("refused", detail=repr(text))
        unit, *words = text.split() or [""]
        if len(unit) != 1 or not unit.isupper():
            return Answer("damaged", detail=repr(text))
        if unit != self._unit:
            return Answer("stranger", detail=repr(text))
        numbers, codes = words[: self._numbers], words[self._numbers :]
        form = rf"[-+]\d+\.\d{{{self._digits}}}"
        where = [numbers[k] for k in self._at] if len(numbers) == self._numbers else []
        if not where or any(
            len(word) != self._width or not re.fullmatch(form, word) for word in where
        ):
            return Answer("damaged", detail=repr(text))
        for code in codes:
            if code in BEYOND:
                return Answer(BEYOND[code], detail=repr(text))
            if code not in (*HOLDS, *HARMLESS):
                return Answer("damaged", detail=repr(text))
        pressure, set_point = (float(word) * self._kpa for word in where)
        holds = any(code in HOLDS for code in codes)
        return Answer("", pressure, not holds, repr(text), set_point)

    def _take(self, host_ns: int, item: Parsed) -> None:
        super()._take(host_ns, item)
        wanted = self.set_kpa_now
        if item.fault or not isinstance(item, Answer) or wanted is None or self._told:
            return
        assert item.set_point is not None
        if abs(item.set_point - wanted) > 0.6 * self.step_kpa or not item.stable:
            self._told = True
            self.faults.add("unset", item.detail)
            raise DeviceError(
                self.name,
                f"its set-point reads back as {item.set_point:.2f} kPa, {wanted:.2f} kPa was sent"
                if item.stable
                else f"holds its valves ({item.detail})",
                "another program or person commands the regulator: end that first",
            )

    def set_kpa(self, pressure_kpa: float, tries: int = TRIES) -> float:
        """See :meth:`RegulatorLine.set_kpa`; the answer is a frame with the set-point in it."""
        text = f"{pressure_kpa / self._kpa:.{self._digits}f}"
        wanted = float(text) * self._kpa

        def good(answer: Answer) -> bool:
            near = answer.set_point is not None and abs(answer.set_point - wanted) < 0.6 * step
            return near and answer.stable

        step = self.step_kpa
        self.set_kpa_now = None
        answer = self._exchange(
            f"{self._unit}S{text}\r".encode(), good, tries, f"set to {wanted:.2f} kPa"
        )
        self.set_kpa_now = wanted
        assert answer.set_point is not None
        return answer.set_point


def open_source(parts: SourceParts) -> PressureSource:
    """The source ``alicat-pcd`` of a rig file."""
    settings = parts.config.pressure_source
    table = settings.table()
    unit = table.text("unit", "A")
    if not re.fullmatch("[A-Z]", unit):
        raise table.fail("unit", f"{unit!r} is not a letter from A to Z")
    monitor = read_monitor(table)
    table.finish()
    check_reach(settings.file, parts.config.limits.pressure_kpa, monitor.full_kpa)
    line = AlicatLine(parts.open_link(), parts.event_loop, monitor.form, unit)
    line.connect(settings.serial)
    return ProportionalSource(
        RegulatorOutput(parts.valve, parts.config), line, monitor.accuracy_kpa
    )
