"""One table of a mapping file, read strictly: every key is known, present and of its type."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable
from typing import Any

from gap.errors import GapError


class Section:
    """A table of the mapping file and where it stands; errors name both.

    `close` must be called after the last key was taken: it refuses the keys that nobody asked for.
    """

    def __init__(self, table: dict[str, Any], path: str, name: str = "") -> None:
        self._table = table
        self._path = path
        self._name = name
        self._asked: set[str] = set()

    def __contains__(self, key: str) -> bool:
        self._asked.add(key)
        return key in self._table

    @property
    def keys(self) -> list[str]:
        """Keys of the table, in the order of the file."""
        return list(self._table)

    def where(self, key: str = "") -> str:
        """File and key, for a message."""
        return f"{self._path}: {'.'.join(part for part in (self._name, key) if part)}"

    def error(self, key: str, what: str, remedy: str = "") -> GapError:
        """An error that names file and key."""
        return GapError(self.where(key), what, remedy)

    def missing(self, key: str, expected: str = "") -> GapError:
        """An error for a key that is not there, with the key that may be it misspelt."""
        near = difflib.get_close_matches(key, [k for k in self._table if k not in self._asked], n=1)
        return self.error(key, "is missing", f"is {near[0]} that key?" if near else expected)

    def value(self, key: str, required: bool = False) -> Any:
        """The value as it stands there; None where it is absent. Raises `GapError`."""
        if key not in self:
            if required:
                raise self.missing(key)
            return None
        return self._table[key]

    def text(self, key: str, default: str = "", required: bool = False) -> str:
        """A text that is not empty."""
        value = self.value(key, required)
        if value is None:
            return default
        if not isinstance(value, str) or not value:
            raise self.error(key, f"expected a text, got {value!r}")
        return value

    def choice(self, key: str, among: Iterable[str], default: str = "") -> str:
        """One of several words; `default` "" makes it required."""
        words = list(among)
        value = self.text(key, default, required=not default)
        if value not in words:
            raise self.error(key, f"{value!r} is not one of {', '.join(words)}")
        return value

    def number(self, key: str, default: float | None = None) -> float | None:
        """A finite number."""
        value = self.value(key)
        if value is None:
            return default
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if not number or not math.isfinite(value):
            raise self.error(key, f"expected a number, got {value!r}")
        return float(value)

    def positive(self, key: str, required: bool = False) -> float | None:
        """A number above zero."""
        value = self.number(key)
        if value is None and required:
            raise self.missing(key)
        if value is not None and value <= 0.0:
            raise self.error(key, f"expected a number above 0, got {value:g}")
        return value

    def count(self, key: str, default: int | None = None) -> int | None:
        """A whole number, 0 or more."""
        value = self.value(key)
        if value is None:
            return default
        if not isinstance(value, int) or isinstance(value, bool) or value < 0:
            raise self.error(key, f"expected a whole number of 0 or more, got {value!r}")
        return value

    def flag(self, key: str, default: bool = False) -> bool:
        """True or false."""
        value = self.value(key)
        if value is None:
            return default
        if not isinstance(value, bool):
            raise self.error(key, f"expected true or false, got {value!r}")
        return value

    def texts(
        self, key: str, default: tuple[str, ...] = (), empty: bool = False
    ) -> tuple[str, ...]:
        """One text or a list of texts; `empty` allows the text of no letter."""
        value = self.value(key)
        if value is None:
            return default
        words = value if isinstance(value, list) else [value]
        for word in words:
            if not isinstance(word, str) or not (word or empty):
                raise self.error(key, f"expected a text or a list of texts, got {word!r}")
        return tuple(words)

    def scalars(self, key: str) -> tuple[str | float, ...] | None:
        """A list of texts and numbers (or one); None where it is absent."""
        value = self.value(key)
        if value is None:
            return None
        items = value if isinstance(value, list) else [value]
        for item in items:
            if isinstance(item, bool) or not isinstance(item, (str, int, float)):
                raise self.error(key, f"expected numbers or texts, got {item!r}")
        return tuple(item if isinstance(item, str) else float(item) for item in items)

    def column(self, key: str = "column", required: bool = False) -> str:
        """Name of a column, or its number from 1 as text in the form "#3"; "" where absent."""
        value = self.value(key, required)
        if value is None:
            return ""
        if isinstance(value, int) and not isinstance(value, bool) and value >= 1:
            return f"#{value}"
        if isinstance(value, str) and value:
            return value
        raise self.error(key, f"expected a column's name, or its number from 1, got {value!r}")

    def columns(self, key: str) -> tuple[str, ...]:
        """One column or a list of them."""
        value = self.value(key)
        items = value if isinstance(value, list) else [] if value is None else [value]
        one = [Section({key: item}, self._path, self._name).column(key) for item in items]
        return tuple(one)

    def table(self, key: str) -> Section | None:
        """A table within; None where it is absent."""
        value = self.value(key)
        if value is None:
            return None
        if not isinstance(value, dict):
            raise self.error(key, f"expected a table, got {value!r}")
        return Section(value, self._path, ".".join(p for p in (self._name, key) if p))

    def raw(self, key: str) -> dict[str, Any]:
        """A table as it stands there; empty where it is absent."""
        value = self.value(key)
        if value is None:
            return {}
        if not isinstance(value, dict):
            raise self.error(key, f"expected a table, got {value!r}")
        return value

    def close(self) -> None:
        """Refuse keys that nobody asked for. Raises `GapError`."""
        for key in self._table:
            if key not in self._asked:
                near = difflib.get_close_matches(key, self._asked, n=1)
                known = ", ".join(sorted(self._asked))
                hint = f"did you mean {near[0]}?" if near else f"known: {known}"
                raise self.error(key, "unknown key", hint)
