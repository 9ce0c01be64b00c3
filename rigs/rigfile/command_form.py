"""How an instrument is set and read back, line by line: a TOML description, no code.

A description names what may be set (``[set.NAME]``) and what may be measured (``[get.NAME]``).
`rigs.rigfile.form` describes instruments that only give readings.
"""

from __future__ import annotations

import re
import string
from dataclasses import dataclass, field

from rigs.rigfile.form import ENDS, SPEC
from rigs.rigfile.toml_reader import Table, load_toml

NUMBER = re.compile(r"(?P<value>[-+]?\d+(\.\d+)?(E[-+]?\d+)?)", re.IGNORECASE)
"""The answer to a query, where the description gives no pattern of its own."""
SAMPLES: dict[str, float | str] = {"value": 1.0, "word": "ON", "number": 1}
"""What a template must be able to print."""


@dataclass(frozen=True)
class SetForm:
    """One quantity that can be set.

    Attributes:
        name: the quantity with its unit, ``voltage_v``; a switch needs no unit.
        command: the line to send, with ``{value}`` (and a plain format), or ``{word}``.
        unit: unit of ``{value}``.
        low, high: limits of the value, in ``unit``.
        words: for a switch, the words for 0 and 1; empty for a number.
        reply: pattern of the answer to the command itself; None where the command has none.
        read_back: query whose answer must equal the value; "" where the device has none.
        pattern: of that answer, with the group ``value``.
        tolerance: by how much it may differ, in ``unit``.
        remedy: what to do when it differs.
    """

    name: str
    command: str
    unit: str = ""
    low: float = 0.0
    high: float = 1.0
    words: tuple[str, ...] = ()
    reply: re.Pattern[str] | None = None
    read_back: str = ""
    pattern: re.Pattern[str] = NUMBER
    tolerance: float = 0.0
    remedy: str = ""

    def line(self, value: float) -> str:
        """The command for a value."""
        if self.words:
            return self.command.format(word=self.words[int(value)])
        return self.command.format(value=value)

    def shown(self, value: float) -> str:
        """A value as a message shows it: a word, or a number in the command's format and unit."""
        if self.words:
            return self.words[int(value)]
        specs = [spec for _, name, spec, _ in string.Formatter().parse(self.command) if name]
        return f"{value:{specs[0]}} {self.unit}".strip()

    def read(self, answer: str) -> float:
        """The value in the answer to ``read_back``."""
        if self.words:
            return float(answer == self.words[1] or answer == "1")
        match = self.pattern.fullmatch(answer)
        assert match is not None
        return float(match["value"])


@dataclass(frozen=True)
class GetForm:
    """One quantity that can be measured: the query, and the pattern of its answer."""

    name: str
    query: str
    unit: str
    pattern: re.Pattern[str] = NUMBER


@dataclass(frozen=True)
class CommandForm:
    """A line-based instrument that is set.

    Attributes:
        name: what the instrument is.
        settings: what can be set, by name.
        queries: what can be measured, by name.
        end: line end, sent.
        timeout_s: how long an answer may take.
        identify: query for the identity, "" for none; the groups of ``identify_pattern`` are
            the identity, one of them is ``serial``.
        sync_set, sync_query: write a ``{number}`` and read it back. Everything that comes before
            that number is older and is thrown away. "" where there is no such register: the line
            must then be silent for four time-outs.
        error_query: asked after each command, with the group ``code`` in ``error_pattern``;
            0 means that the command was taken. "" for none.
        overload: a number of this size or more is no value; negative means underload.
    """

    name: str
    settings: dict[str, SetForm] = field(default_factory=dict)
    queries: dict[str, GetForm] = field(default_factory=dict)
    end: bytes = b"\r\n"
    timeout_s: float = 0.5
    identify: str = ""
    identify_pattern: re.Pattern[str] = NUMBER
    sync_set: str = ""
    sync_query: str = ""
    error_query: str = ""
    error_pattern: re.Pattern[str] = NUMBER
    overload: float = float("inf")


def load_command_form(name: str) -> CommandForm:
    """Read a description given as a path or as the name of a shipped one.

    Raises:
        ConfigError: names file, key, what is wrong and what to do.
    """
    t = load_toml(name, "instruments")
    settings, queries = t.table("set", optional=True), t.table("get", optional=True)
    form = CommandForm(
        name=t.text("name"),
        settings={key: _setting(settings.table(key), key) for key in settings.keys()},  # noqa: SIM118
        queries={key: _query(queries.table(key), key) for key in queries.keys()},  # noqa: SIM118
        end=ENDS[t.text("end", "crlf", choices=tuple(ENDS))],
        timeout_s=t.number("timeout_s", 0.01, 60, 0.5, unit="s"),
        identify=t.text("identify", ""),
        identify_pattern=_pattern(t, "identify_pattern", "serial", "identify" in t),
        sync_set=_template(t, "sync_set", "number") if "sync_set" in t else "",
        sync_query=t.text("sync_query") if "sync_set" in t else "",
        error_query=t.text("error_query", ""),
        error_pattern=_pattern(t, "error_pattern", "code", "error_query" in t),
        overload=t.number("overload", 0, 1e300, 1e300),
    )
    t.finish()
    return form


def _setting(t: Table, name: str) -> SetForm:
    given = t.raw("words", [])
    listed = isinstance(given, list) and len(given) in (0, 2)
    if not listed or not all(isinstance(word, str) for word in given):
        raise t.fail("words", f"expected two words, for 0 and 1, got {given!r:.40}")
    words = tuple(given)
    low = 0.0 if words else t.number("low", -1e9, 1e9)
    default = re.compile("|".join(map(re.escape, ("0", "1", *words)))) if words else NUMBER
    form = SetForm(
        name=name,
        command=_template(t, "command", "word" if words else "value"),
        unit="" if words else t.text("unit"),
        low=low,
        high=1.0 if words else t.number("high", low, 1e9),
        words=words,
        reply=_pattern(t, "reply", "", True) if "reply" in t else None,
        read_back=t.text("read_back", ""),
        pattern=_pattern(t, "pattern", "value", True) if "pattern" in t else default,
        tolerance=0.5 if words else t.number("tolerance", 0, 1e9, 0.0),
        remedy=t.text("remedy", ""),
    )
    t.finish()
    return form


def _query(t: Table, name: str) -> GetForm:
    form = GetForm(
        name, t.text("query"), t.text("unit"),
        _pattern(t, "pattern", "value", True) if "pattern" in t else NUMBER,
    )  # fmt: skip
    t.finish()
    return form


def _template(t: Table, key: str, wanted: str) -> str:
    """A line with exactly one field of that name, in a plain format."""
    text = t.text(key)
    try:
        parts = [p for p in string.Formatter().parse(text) if p[1] is not None]
        good = len(parts) == 1 and parts[0][1] == wanted and not parts[0][3]
        good = good and SPEC.fullmatch(parts[0][2] or "") is not None and text.isascii()
        text.format(**{wanted: SAMPLES[wanted]})
    except (ValueError, KeyError, IndexError, AttributeError):
        good = False
    if not good:
        raise t.fail(
            key, f"{text!r} is not a line with one {{{wanted}}}", "write {value:.3f} or so"
        )
    return text


def _pattern(t: Table, key: str, group: str, needed: bool) -> re.Pattern[str]:
    text = t.text(key) if needed else t.text(key, NUMBER.pattern)
    try:
        pattern = re.compile(text)
    except re.error as error:
        raise t.fail(key, f"is not a regular expression: {error}", "correct it") from None
    if needed and group and group not in pattern.groupindex:
        raise t.fail(key, f"has no group (?P<{group}>...)", "mark it in the pattern")
    return pattern
