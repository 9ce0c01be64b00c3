"""Changes of a document's structure: a value of a TOML or JSON file replaced by another kind.

Changes of bytes rarely make a valid document with a wrong value in it; these always do.
"""

from __future__ import annotations

import copy
import json
import random
import tomllib
from collections.abc import Iterator
from datetime import date
from typing import Any

Place = tuple[str | int, ...]

STRANGE: tuple[Any, ...] = (
    5, -1, 0, 2**62, 1e-300, 1e300, float("inf"), float("nan"), True, "", "word", "x" * 5000,
    "\x1b[2J\u202e", "../../evil", "/dev/zero", [], [[]], [5, "word"], {}, {"a": 5}, {"": {}},
    date(2026, 1, 1),
)  # fmt: skip
"""Replacements; JSON has a few more."""
STRANGE_JSON: tuple[Any, ...] = (*STRANGE[:-1], None, "\ud800", "\0", [None], 10**400)


def places(value: Any, at: Place = ()) -> Iterator[Place]:
    """Every place of a document, tables and lists included."""
    if at:
        yield at
    if isinstance(value, dict):
        for key in value:
            yield from places(value[key], (*at, key))
    elif isinstance(value, list):
        for number, inner in enumerate(value[:3]):
            yield from places(inner, (*at, number))


def replaced(document: dict[str, Any], at: Place, value: Any) -> dict[str, Any]:
    """A copy with another value at one place."""
    out = copy.deepcopy(document)
    inner: Any = out
    for key in at[:-1]:
        inner = inner[key]
    inner[at[-1]] = value
    return out


def without(document: dict[str, Any], at: Place) -> dict[str, Any]:
    """A copy without the value at one place."""
    out = copy.deepcopy(document)
    inner: Any = out
    for key in at[:-1]:
        inner = inner[key]
    del inner[at[-1]]
    return out


def change_toml(data: bytes, rng: random.Random) -> bytes:
    """One value replaced, removed, or its key made long; the bytes as they are if not TOML."""
    try:
        document = tomllib.loads(data.decode())
    except (ValueError, RecursionError):
        return data
    try:
        return toml(_changed(document, rng, STRANGE)).encode("utf-8", "replace")
    except RecursionError:
        return data


def change_json(fields: dict[str, Any], rng: random.Random) -> dict[str, Any]:
    """As :func:`change_toml` for the members of a JSON object."""
    return _changed(fields, rng, STRANGE_JSON)


CELLS = (
    b"1e-300", b"1e300", b"-5", b"inf", b"nan", b"x" * 5000, b"", b'"', b"\xed\xa0\x80",
    b"9" * 400, b"\x1b[2J", b"0x10", b"1_000", b"True", b"2026-01-01", b"\0",
)  # fmt: skip


def change_csv(data: bytes, rng: random.Random) -> bytes:
    """One to three cells of a CSV replaced, the header's too."""
    rows = [line.split(b",") for line in data.split(b"\n")]
    for _ in range(rng.choice((1, 1, 2, 3))):
        row = rng.choice(rows)
        row[rng.randrange(len(row))] = rng.choice(CELLS)
    return b"\n".join(b",".join(row) for row in rows)


def _changed(
    document: dict[str, Any], rng: random.Random, strange: tuple[Any, ...]
) -> dict[str, Any]:
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        there = list(places(document))
        if not there:
            return document
        at, kind = rng.choice(there), rng.random()
        if kind < 0.1:
            document = without(document, at)
        elif kind < 0.2:
            document = (
                replaced(document, (*at[:-1], "k" * 5000), 5)
                if isinstance(at[-1], str)
                else replaced(document, at, rng.choice(strange))
            )
        else:
            document = replaced(document, at, rng.choice(strange))
    return document


def toml(table: dict[str, Any]) -> str:
    """A TOML text of a table; inner tables stand inline, which any parser reads the same."""
    return "".join(f"{_key(key)} = {_value(value)}\n" for key, value in table.items())


def _key(key: str) -> str:
    return json.dumps(key).replace("\x7f", "\\u007f")


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_key(k)} = {_value(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_value, value)) + "]"
    if isinstance(value, str):
        return _key(value)
    if isinstance(value, float):
        text = repr(value)
        return text if any(c in text for c in ".enf") else text + ".0"
    return str(value)
