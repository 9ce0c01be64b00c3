"""What readers of TOML files ask for, recorded while they read.

The two classes through which most files are read, `rigs.rigfile.toml_reader.Table` and
`gap.mapping.section.Section`, are wrapped for the time of the recording. Each question becomes an
`Asked`: key, type, bounds, default, unit and choices, as the reader states them.
"""

from __future__ import annotations

import functools
import inspect
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Any

from gap.mapping.section import Section
from rigs.rigfile.toml_reader import Table

HOUSE = Path(__file__).resolve().parents[2]
TABLE_METHODS = (
    "number", "integer", "text", "ascii", "texts", "flag", "numbers", "table", "row", "raw",
)  # fmt: skip
SECTION_METHODS = (
    "value", "text", "choice", "number", "positive", "count", "flag", "texts", "scalars", "column",
    "columns", "table", "raw",
)  # fmt: skip
_FORMS = {
    "ascii": "text", "choice": "text", "integer": "whole number", "count": "whole number",
    "number": "number", "positive": "number", "text": "text", "flag": "true or false",
    "numbers": "list of numbers", "texts": "list of texts", "scalars": "list of numbers or texts",
    "column": "column name or number", "columns": "list of column names or numbers",
    "table": "table", "row": "list of tables",
}  # fmt: skip
REQUIRED = "required"
VARIES = "*"
"""A bound or default that depends on another key or on the rig file."""
Where = tuple[str, str, str]
"""Kind of file, table, key."""


@dataclass
class Asked:
    """All questions for one key.

    Attributes:
        forms: types, in words; "" where the reader takes the value as it is.
        limits, defaults, choices, units: as stated in each question.
        found: types of the values that were there.
        tested: whether a reader looks whether the key is present.
        absent: whether one asked where it was not.
    """

    forms: set[str] = field(default_factory=set)
    limits: set[tuple[Any, Any]] = field(default_factory=set)
    defaults: set[Any] = field(default_factory=set)
    choices: set[tuple[str, ...]] = field(default_factory=set)
    units: set[str] = field(default_factory=set)
    found: set[str] = field(default_factory=set)
    tested: bool = False
    absent: bool = False


class Recorder:
    """Questions by kind of file, table and key, and the lines of code that asked.

    Args:
        place: (source file as the reader knows it, file of the code that asks, table) -> kind and
            table, or None for a file that is not recorded here.
    """

    def __init__(self, place: Callable[[str, str, str], tuple[str, str] | None]) -> None:
        self._place = place
        self._depth = 0
        self.keys: dict[Where, Asked] = {}
        self.lines: set[tuple[str, int, str]] = set()

    def _at(self, source: str, table: str, key: str) -> Asked | None:
        placed = self._place(source, sys._getframe(2).f_code.co_filename, table)
        if placed is None:
            return None
        return self.keys.setdefault((*placed, key), Asked())

    def _reached(self, key: str) -> None:
        frame: FrameType | None = sys._getframe(2)
        for _ in range(6):
            if frame is None:
                return
            self.lines.add((frame.f_code.co_filename, frame.f_lineno, key))
            frame = frame.f_back

    def _wrap(self, method: str, plain: Callable[..., Any], about: Callable[[Any], tuple[str, str]]) -> Callable[..., Any]:  # fmt: skip  # noqa: E501
        signature = inspect.signature(plain)

        @functools.wraps(plain)
        def asking(this: Any, *given: Any, **more: Any) -> Any:
            if self._depth:
                return plain(this, *given, **more)
            bound = signature.bind(this, *given, **more)
            bound.apply_defaults()
            stated = bound.arguments
            self._reached(stated["key"])
            asked = self._at(*about(this), stated["key"])
            self._depth += 1
            try:
                there = stated["key"] in this
                value = plain(this, *given, **more)
            finally:
                self._depth -= 1
            if asked is not None:
                _note(asked, method, stated, value)
                asked.absent |= not there
            return value

        return asking

    def _tested(self, plain: Callable[..., bool], about: Callable[[Any], tuple[str, str]]) -> Callable[..., bool]:  # fmt: skip  # noqa: E501
        @functools.wraps(plain)
        def asking(this: Any, key: str) -> bool:
            if not self._depth:
                asked = self._at(*about(this), key)
                if asked is not None:
                    asked.tested = True
            return plain(this, key)

        return asking

    @contextmanager
    def recording(self) -> Iterator[Recorder]:
        """Record all questions within the block."""
        kept = []
        for owner, methods, about in (
            (Table, TABLE_METHODS, lambda t: (t.source, t.path)),
            (Section, SECTION_METHODS, lambda t: (t._path, t._name)),
        ):
            for name in (*methods, "__contains__"):
                plain = owner.__dict__[name]
                kept.append((owner, name, plain))
                tested = name == "__contains__"
                made = self._tested(plain, about) if tested else self._wrap(name, plain, about)
                setattr(owner, name, made)
        try:
            yield self
        finally:
            for owner, name, plain in kept:
                setattr(owner, name, plain)


def _note(asked: Asked, method: str, stated: dict[str, Any], value: Any) -> None:
    """Add one question to what is known of a key."""
    form = _FORMS.get(method, "")
    if form:
        asked.forms.add(form)
    if value is not None:
        asked.found.add(type_of(value))
    if method in ("number", "integer", "numbers") and "low" in stated:
        asked.limits.add((stated["low"], stated["high"]))
    elif method == "positive":
        asked.limits.add(("above 0", None))
    elif method == "count":
        asked.limits.add((0, None))
    absent = None if stated.get("optional") or method == "raw" else ...
    default = stated.get("default", absent)
    if method == "choice" and default == "":
        default = ...
    if "required" in stated:
        default = ... if stated["required"] else stated.get("default")
    elif method in ("number", "count", "scalars", "columns", "positive", "texts") and (
        "low" not in stated and "choices" not in stated
    ):
        default = stated.get("default")
    if method == "table" and "optional" not in stated:  # of a mapping: absent is None
        default = None
    asked.defaults.add(REQUIRED if default is ... else _frozen(default))
    words = stated.get("choices") or stated.get("among")
    if words:
        asked.choices.add(tuple(words))
    if method in ("number", "numbers", "positive"):
        asked.units.add(stated.get("unit", ""))


def _frozen(value: Any) -> Any:
    if isinstance(value, dict):
        return tuple(value)
    return tuple(value) if isinstance(value, (list, tuple)) else value


def type_of(value: Any) -> str:
    """A value's type, in words."""
    if isinstance(value, (list, tuple)):
        inner = {"list" if isinstance(item, list) else type_of(item) for item in value}
        if inner and inner <= {"whole number", "number"}:
            inner = {"number"}
        return f"list of {inner.pop()}s" if len(inner) == 1 else "list"
    if isinstance(value, (dict, Table, Section)):
        return "table"
    words: dict[type, str] = {bool: "true or false", int: "whole number", float: "number"}
    return words.get(type(value), "text")
