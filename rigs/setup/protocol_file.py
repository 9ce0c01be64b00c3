"""A protocol file from questions: the shipped file of a test with other values, comments kept."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from rigs.rigfile.toml_reader import find_config
from rigs.setup.questions import Interview

_TABLE = re.compile(r"^\[(?P<name>[\w.]+)\]")
_LINE = re.compile(
    r'^(?P<key>\w+)\s*=\s*(?P<value>"[^"]*"|\[[^\]]*\]|[^\s#"\[]+)(?P<rest>\s*(?:#.*)?)$'
)
UNITS = {"mm": "mm", "kpa": "kPa", "kg": "kg", "s": "s", "n": "N", "v": "V", "ms": "ms",
         "c": "°C", "deg": "deg", "hz": "1/s"}  # fmt: skip
MOST = 1e6
MADE = "# Made by `pamrig init protocol` from the shipped file"


@dataclass(frozen=True)
class Entry:
    """One line ``key = value`` of the shipped file.

    Attributes:
        at: number of the line.
        table: its table, "" for the top.
        key, value: as in the file.
        comment: what stands behind it.
    """

    at: int
    table: str
    key: str
    value: Any
    comment: str

    @property
    def name(self) -> str:
        """Key of the answer."""
        return f"{self.table}.{self.key}" if self.table else self.key

    @property
    def question(self) -> str:
        """The key, and what the file says of it."""
        said = re.sub(r"\s*\.\.\.\s*$", "", self.comment)
        return f"{self.name} ({said})" if said else self.name

    @property
    def unit(self) -> str:
        """By the end of the key, as everywhere."""
        return UNITS.get(self.key.rpartition("_")[2], "")


def entries(text: str) -> Iterator[Entry]:
    """The lines of a file that hold a value on one line."""
    table = ""
    for at, line in enumerate(text.splitlines()):
        if found := _TABLE.match(line):
            table = found["name"]
        elif found := _LINE.match(line):
            value = tomllib.loads(f"x = {found['value']}")["x"]
            yield Entry(at, table, found["key"], value, found["rest"].strip().lstrip("# "))


def flat(values: Mapping[str, Any], above: str = "") -> dict[str, Any]:
    """Tables of answers as one, with dotted keys."""
    out: dict[str, Any] = {}
    for key, value in values.items():
        name = f"{above}.{key}" if above else key
        out |= flat(value, name) if isinstance(value, Mapping) else {name: value}
    return out


def ask_protocol(ask: Interview, protocol: str, before: Mapping[str, Any] | None = None) -> str:
    """Ask for the values of a test and return its protocol file.

    Args:
        ask: the questions; keys of tables are dotted (``settle.window_s``).
        protocol: name of the test, and of the shipped file.
        before: answers of an earlier round, which are the defaults of this one.

    Raises:
        ConfigError: an answer is refused.
    """
    text, source = find_config(protocol, "protocols")
    lines = text.splitlines()
    found = [e for e in entries(text) if e.name != "protocol"]
    top = [entry for entry in found if not entry.table]
    rest = [entry for entry in found if entry.table]
    taken = dict(before or {})
    for entry in top:
        lines[entry.at] = _line(entry, _value(ask, entry, taken.get(entry.name, entry.value)))
    asked = ask.yes_no(
        "all", "Also preconditioning, settling and the other tables?", bool(taken.get("all", False))
    )
    for entry in rest:
        default = taken.get(entry.name, entry.value)
        if asked or ask.gave(entry.name):
            default = _value(ask, entry, default)
        lines[entry.at] = _line(entry, default)
    ask.finish(tuple(entry.name for entry in rest))
    head = f"{MADE} {source}.\n# Every key: docs/reference/files.md."
    return head + "\n" + "\n".join(line.rstrip() for line in lines) + "\n"


def _value(ask: Interview, entry: Entry, default: Any) -> Any:
    """The answer to one key, of the type that it has in the shipped file."""
    own = entry.value
    if isinstance(own, bool):
        return ask.yes_no(entry.name, entry.question, default)
    if isinstance(own, (int, float)):
        number = ask.number(entry.name, entry.question, default, -MOST, MOST, entry.unit)
        return round(number) if isinstance(own, int) and number == round(number) else number
    if isinstance(own, list) and all(isinstance(v, (int, float)) for v in own):
        numbers = ask.numbers(entry.name, entry.question, tuple(default), -MOST, MOST, entry.unit)
        whole = all(isinstance(v, int) for v in own) and all(v == round(v) for v in numbers)
        return [round(v) for v in numbers] if whole else list(numbers)
    if isinstance(own, list):
        words = ask.text(entry.name, f"{entry.question}, separated by commas", ", ".join(default))
        return [word.strip() for word in words.strip("[] ").split(",") if word.strip()]
    return ask.text(entry.name, entry.question, default)


def _line(entry: Entry, value: Any) -> str:
    said = f"  # {entry.comment}" if entry.comment else ""
    return f"{entry.key} = {json.dumps(value)}".ljust(26) + said
