"""The page docs/reference/files.md: every key of every TOML file that users write.

Keys, types, ranges and defaults come from the readers (`docs.make.readers`, `docs.make.stated`),
the lines of description from `keys.toml`.
"""

from __future__ import annotations

import re
import tomllib
from functools import cache
from pathlib import Path
from typing import Any

from docs.make.asked import HOUSE, REQUIRED, VARIES, Asked, Recorder
from docs.make.kinds import KINDS, Kind
from docs.make.readers import named, recorded
from docs.make.row import Row, number
from docs.make.stated import listed_rows, plain_rows

PAGE = HOUSE / "docs" / "reference" / "files.md"
LINES = Path(__file__).with_name("keys.toml")
HEAD = """# TOML files

Every key of every file that users write: made by `python -m docs.make` from the readers
themselves. A key that is not listed here is refused.

In the column "default", *required* means that the reader refuses a file without the key (for a
key of an optional table: where the table is there), and "none" that nothing is assumed. A `*`
stands for a bound or a default that depends on another key or on the rig file; the description
says on which. Words in capitals (NAME) are chosen by the user. A path is relative to the folder of
the file that states it.
"""
EVERY = "*"
"""In keys.toml: the table or the kind of file whose lines hold for all."""


class Lines:
    """The lines of description, and which of them were used."""

    def __init__(self, path: Path = LINES) -> None:
        self._of: dict[str, dict[str, dict[str, str]]] = tomllib.loads(path.read_text("utf-8"))
        self.used: set[tuple[str, str, str]] = set()
        self.missing: list[str] = []

    def __call__(self, kind: Kind, table: str, key: str) -> str:
        """The line of a key: its own, or one that holds for several tables or kinds of file."""
        for group in (kind.id, kind.group):
            for place in (table, EVERY):
                line = self._of.get(group, {}).get(place, {}).get(key)
                if line is not None:
                    self.used.add((group, place, key))
                    return line
        self.missing.append(f'[{kind.id}."{table}"]  "{key}" = "..."')
        return ""

    def unused(self) -> list[str]:
        """Lines without a key."""
        every = {(g, t, k) for g, tables in self._of.items() for t, keys in tables.items()
                 for k in keys}  # fmt: skip
        return [f'[{g}."{t}"]  {k}' for g, t, k in sorted(every - self.used)]


@cache
def recording() -> Recorder:
    """The recording, made once."""
    return recorded()


def rows() -> list[Row]:
    """All keys of all files."""
    asked = recording().keys
    tables = {(kind, table) for kind, table, _ in asked}
    made = [
        _row(kind, table, key, one)
        for (kind, table, key), one in asked.items()
        if _is_key(kind, table, key, tables)
    ]
    return [*made, *plain_rows(), *listed_rows()]


def _is_key(kind: str, table: str, key: str, tables: set[tuple[str, str]]) -> bool:
    """False for a table that has a section of its own, and for what a user names."""
    if table in ("valve.parameters", "valve_b.parameters"):
        return False  # the firmware's, listed by themselves
    path = f"{table}.{key}" if table else key
    own = named(kind, path)
    below = any(k == kind and (t == path or t.startswith((f"{path}.", f"{path}[]")))
                for k, t in tables)  # fmt: skip
    return not below and (own == path or own.startswith("trials"))


def _row(kind: str, table: str, key: str, one: Asked) -> Row:
    forms = one.forms or set(one.found)
    forms = {form for form in forms if form != "list of tables"} or forms
    limits = _limits(key, one)
    return Row(kind, table, key, " or ".join(sorted(forms)), limits, _default(one))


def _limits(key: str, one: Asked) -> str:
    if len(one.choices) == 1:
        return ", ".join(next(iter(one.choices)))
    units = {u for u in one.units if u}
    unit = units.pop() if len(units) == 1 else ""
    if "" in one.units and not key.endswith(f"_{unit.lower()}"):
        unit = ""  # not in every case
    if not one.limits:
        return unit
    lows, highs = ({pair[k] for pair in one.limits} for k in (0, 1))
    low = _one(lows)
    if highs == {None}:
        return (low if low.startswith("above") else f"{low} or more") + f" {unit}".rstrip()
    return f"{low} to {_one(highs)} {unit}".strip()


def _one(values: set[Any]) -> str:
    if len(values) != 1:
        return VARIES
    (value,) = values
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (int, float)):
        return "none" if value != value or abs(value) >= 1e300 else number(value)
    if isinstance(value, tuple):
        return f"[{', '.join(_one({v}) for v in value)}]"
    return str(value)


def _default(one: Asked) -> str:
    if one.tested and not one.absent:
        return ""  # the reader asks only where the key is there
    found = {value for value in one.defaults if value is not None} or {None}
    text = _one(found)
    return "" if text in ("", "None", "[]", "none") else text


def page(lines: Lines | None = None) -> str:
    """The page."""
    lines = lines or Lines()
    every = rows()
    parts = [HEAD, _contents()]
    for kind in KINDS:
        own = [row for row in every if row.kind == kind.id]
        if own:
            parts.append(_section(kind, own, lines))
    return "\n".join(parts).rstrip() + "\n"


def _contents() -> str:
    head = "| file | content |\n|---|---|\n"
    return head + "".join(f"| [{k.title}](#{anchor(k.title)}) | {k.what} |\n" for k in KINDS)


def anchor(title: str) -> str:
    """The anchor of a heading, as GitHub and MyST make it."""
    return re.sub(r"[^a-z0-9 -]", "", title.lower()).replace(" ", "-")


def _section(kind: Kind, own: list[Row], lines: Lines) -> str:
    parts = [f"## {kind.title}\n", f"{kind.text}\n"]
    listed = kind.id in ("effects", "firmware")
    tables = dict.fromkeys(row.table for row in own)
    for table in sorted(tables, key=lambda name: (name != "", kind.order(name), "")):
        if table:
            parts.append(f"### {heading(table)}\n")
            line = _effect(table) if kind.id == "effects" else lines(kind, table, "")
            parts.append(f"{line}\n")
        parts.append(_table([row for row in own if row.table == table], kind, lines, listed))
    return "\n".join(parts)


def _effect(table: str) -> str:
    from plant.effects.catalogue import CATALOGUE

    text = CATALOGUE[table.partition(".")[2]].summary
    return f"{text[0].upper()}{text[1:].rstrip('.')}."


def heading(table: str) -> str:
    """A table as it stands in a file, as code."""
    return f"`[[{table[:-2]}]]`" if table.endswith("[]") else f"`[{table}]`"


def _table(own: list[Row], kind: Kind, lines: Lines, listed: bool) -> str:
    made = ["| key | type | range | default | description |", "|---|---|---|---|---|"]
    for row in own:
        line = row.line if listed else lines(kind, row.table, row.key)
        cells = (f"`{row.key}`", row.form, row.limits, _shown(row.default), line)
        made.append("| " + " | ".join(_cell(cell) for cell in cells) + " |")
    return "\n".join(made) + "\n"


def _shown(default: str) -> str:
    return f"*{REQUIRED}*" if default == REQUIRED else default or "none"


def _cell(text: str) -> str:
    return re.sub(r"\s+", " ", text.replace("|", "\\|").replace("\n", " ")).strip()


def main() -> None:
    """Write the page.

    Raises:
        SystemExit: a key has no line, or a line has no key.
    """
    lines = Lines()
    text = page(lines)
    for missing in lines.missing:
        print(f"{LINES.name}: no line for {missing}")
    for unused in lines.unused():
        print(f"{LINES.name}: no reader asks for {unused}")
    if lines.missing:
        raise SystemExit(1)
    PAGE.write_text(text, "utf-8")
