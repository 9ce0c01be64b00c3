"""How an instrument writes a reading: a TOML description, no code."""

from __future__ import annotations

import re
import string
from dataclasses import dataclass

from daq.errors import ConfigError
from rigs.rigfile.toml_reader import Table, load_toml

ENDS = {"crlf": b"\r\n", "lf": b"\n", "cr": b"\r"}
NUMBER = re.compile(r"[-+]?\d+(\.\d*)?([eE][-+]?\d+)?")
STANDARD_GRAVITY_M_S2 = 9.80665
GRAMS = {"g": 1.0, "kg": 1000.0, "N": 1000.0 / STANDARD_GRAVITY_M_S2,
         "lb": 453.59237, "kN": 1e6 / STANDARD_GRAVITY_M_S2}  # fmt: skip
"""Grams in a unit that indicators print; newtons are the indicator's own, at standard gravity."""
FIELDS = ("value", "unit", "status")
SPEC = re.compile(r"([<>=^])?[-+ ]?0?\d{0,2}(\.\d{1,2})?[defgs]?")
"""Of a template: an alignment, a sign, a width and a precision, both short."""


@dataclass(frozen=True)
class Parsed:
    """What a line turned out to be.

    Attributes:
        fault: kind of fault (see ``rigs.devices.faults``), or "" for a good reading.
        value: the reading in the instrument's unit.
        stable: False where the instrument says that it still moves.
        detail: words for a message.
    """

    fault: str
    value: float = 0.0
    stable: bool = True
    detail: str = ""


@dataclass(frozen=True)
class TextForm:
    """A line-based instrument: what to ask, what comes, in which unit, how often.

    Attributes:
        name: what the instrument is.
        quantity: what it measures, with unit: ``temperature_c``.
        unit: unit as the instrument prints it; another one is a fault.
        pattern: regular expression over a whole line, with the groups ``value`` and, where
            the instrument prints them, ``unit`` and ``status``.
        example: a line as the instrument prints it; the pattern is held against it.
        query: what to send for a reading; "" for an instrument that sends by itself.
        start: sent once when the port is opened.
        end: line end, sent and expected.
        width: exact number of characters in a line (checksum apart), 0 when it varies. A
            lost character inside a number shows only by this or a checksum.
        checksum: "none", or two hex digits after ``checksum_mark``: "xor" or "sum" of all
            characters before it.
        stable: what ``status`` says at rest; "" when every reading counts as at rest.
        overload, underload: regular expressions over a whole line.
        low, high: what the instrument can read, in its unit.
        rate_hz: readings a second, sent or asked for.
        timeout_s: how long an answer may take.
        identify: what to send for its identity, "" for none.
        identify_pattern: over the whole answer, with the group ``serial``.
        tare: what to send for a tare, "" when it has none.
        template: how the virtual bench prints a reading (Python format of ``value``).
    """

    name: str
    quantity: str
    unit: str
    pattern: re.Pattern[str]
    example: str
    query: str = ""
    start: str = ""
    end: bytes = b"\r\n"
    width: int = 0
    checksum: str = "none"
    checksum_mark: str = "*"
    stable: str = ""
    overload: re.Pattern[str] | None = None
    underload: re.Pattern[str] | None = None
    low: float = -1e9
    high: float = 1e9
    rate_hz: float = 1.0
    timeout_s: float = 0.5
    identify: str = ""
    identify_pattern: re.Pattern[str] | None = None
    tare: str = ""
    template: str = ""

    def parse(self, line: str) -> Parsed:
        """What a line is; anything but a whole, checked line in the right unit is a fault."""
        body = line
        if self.checksum != "none":
            body, mark, digits = line.rpartition(self.checksum_mark)
            if not mark:
                return Parsed("damaged", detail=f"no checksum in {line!r}")
            if digits.upper() != checksum(body, self.checksum):
                return Parsed("checksum", detail=repr(line))
        for kind, flag in (("overload", self.overload), ("underload", self.underload)):
            if flag is not None and flag.fullmatch(body):
                return Parsed(kind, detail=repr(line))
        match = self.pattern.fullmatch(body)
        if match is None:
            dotted = re.sub(r"(?<=\d),(?=\d)", ".", body)
            if dotted != body and self.pattern.fullmatch(dotted):
                return Parsed("comma", detail=repr(line))
            return Parsed("damaged", detail=repr(line))
        groups = match.groupdict()
        text = groups["value"].replace(" ", "")
        if "," in text:
            return Parsed("comma", detail=repr(line))
        unit = groups.get("unit")
        if unit is not None and unit.strip() != self.unit:
            return Parsed("unit", detail=f"{unit.strip()!r} instead of {self.unit!r} in {line!r}")
        if not NUMBER.fullmatch(text) or (self.width and len(body) != self.width):
            return Parsed("damaged", detail=repr(line))
        value = float(text)
        if not self.low <= value <= self.high:
            return Parsed("range", detail=f"{value:g} {self.unit} in {line!r}")
        status = groups.get("status")
        return Parsed("", value, not self.stable or status is None or status == self.stable)

    def seal(self, body: str) -> bytes:
        """A line as bytes: checksum and end added. What the virtual bench sends."""
        if self.checksum != "none":
            body += self.checksum_mark + checksum(body, self.checksum)
        return body.encode("ascii") + self.end


def checksum(body: str, kind: str) -> str:
    """Two hex digits over all characters: their exclusive or, or their sum."""
    total = 0
    for byte in body.encode("latin-1", "replace"):
        total = total ^ byte if kind == "xor" else total + byte
    return f"{total & 0xFF:02X}"


def load_form(name: str) -> TextForm:
    """Read a description given as a path or as the name of a shipped one.

    Raises:
        ConfigError: names file, key, what is wrong and what to do.
    """
    table = load_toml(name, "instruments")
    form = read_form(table)
    table.finish()
    return form


def read_form(t: Table) -> TextForm:
    """A description out of an open TOML table; the caller finishes the table."""
    end = t.text("end", "crlf", choices=tuple(ENDS))
    form = TextForm(
        name=t.text("name", t.path or "instrument"),
        quantity=t.text("quantity"),
        unit=t.text("unit"),
        pattern=_needed(t, "pattern"),
        example=t.text("example"),
        query=t.text("query", ""),
        start=t.text("start", ""),
        end=ENDS[end],
        width=t.integer("width", 0, 200, 0),
        checksum=t.text("checksum", "none", choices=("none", "xor", "sum")),
        checksum_mark=t.text("checksum_mark", "*"),
        stable=t.text("stable", ""),
        overload=_pattern(t, "overload"),
        underload=_pattern(t, "underload"),
        low=t.number("low", -1e9, 1e9, -1e9),
        high=t.number("high", -1e9, 1e9, 1e9),
        rate_hz=t.number("rate_hz", 0.001, 1000, 1.0, unit="1/s"),
        timeout_s=t.number("timeout_s", 0.01, 60, 0.5, unit="s"),
        identify=t.text("identify", ""),
        identify_pattern=_pattern(t, "identify_pattern"),
        tare=t.text("tare", ""),
        template=t.text("template", ""),
    )
    _check(t, form)
    return form


def _check(t: Table, form: TextForm) -> None:
    """A description that cannot read its own example would never read the instrument."""
    if not re.fullmatch(r"[a-z][a-z0-9]*(_[a-z0-9]+)+", form.quantity):
        raise t.fail("quantity", f"{form.quantity!r} has no unit", 'write it as "temperature_c"')
    if "value" not in form.pattern.groupindex:
        raise t.fail("pattern", "has no group (?P<value>...)", "mark the number in the pattern")
    for key in ("query", "start", "identify", "tare", "example"):
        if not getattr(form, key).isascii():
            raise t.fail(key, "has characters beyond ASCII", "send bytes are ASCII only")
    if form.checksum != "none" and len(form.checksum_mark) != 1:
        raise t.fail("checksum_mark", "expected one character")
    if form.identify and (
        form.identify_pattern is None or "serial" not in form.identify_pattern.groupindex
    ):
        raise t.fail("identify_pattern", "has no group (?P<serial>...)", "mark the serial number")
    if not _plain_template(form.template):
        raise t.fail(
            "template",
            f"{form.template!r} is not a line with {{value}}, {{unit}} and {{status}}",
            'write formats such as "{value:6.2f} {unit}"',
        )
    parsed = form.parse(form.example)
    if parsed.fault:
        raise t.fail(
            "example",
            f"does not read by this description ({parsed.fault}: {parsed.detail})",
            "give a line exactly as the instrument prints it, and correct the pattern",
        )


def _plain_template(template: str) -> bool:
    """Whether it formats the three fields, and reaches for nothing within or behind them."""
    try:
        for _, field, spec, conversion in string.Formatter().parse(template):
            if field is not None and (field not in FIELDS or conversion):
                return False
            if not SPEC.fullmatch(spec or ""):
                return False
        template.format(value=0.0, unit="", status="")
    except ValueError:
        return False
    return True


def _needed(t: Table, key: str) -> re.Pattern[str]:
    pattern = _pattern(t, key)
    if pattern is None:
        raise t.fail(key, "this key is required and missing", "see docs/reference/instruments.md")
    return pattern


def _pattern(t: Table, key: str) -> re.Pattern[str] | None:
    text = t.text(key, "")
    if not text:
        return None
    try:
        return re.compile(text)
    except re.error as error:
        where = f"{t.source}: {t.path}.{key}" if t.path else f"{t.source}: {key}"
        raise ConfigError(where, f"is not a regular expression: {error}", "correct it") from None
