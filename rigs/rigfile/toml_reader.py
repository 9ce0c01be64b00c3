"""Bounded reading of TOML: every value has a type and a range, every key a name.

A typing slip in a rig file must never become a silent default, so a table complains
about keys that nothing reads, and each complaint names file, key and remedy.
"""

from __future__ import annotations

import difflib
import importlib.resources
import os
import tomllib
from pathlib import Path
from typing import Any

from daq.errors import ConfigError
from plant import tomlfile


class Table:
    """One TOML table that is being read.

    Args:
        values: the parsed table.
        source: file name for messages.
        path: dotted key of this table ("" for the root).
    """

    def __init__(self, values: dict[str, Any], source: str, path: str = "") -> None:
        self._values = values
        self.source = source
        self.path = path
        self._seen: set[str] = set()

    def _where(self, key: str) -> str:
        dotted = f"{self.path}.{key}" if self.path else key
        return f"{self.source}: {dotted}"

    def fail(self, key: str, what: str, remedy: str = "") -> ConfigError:
        """A ready-made error about ``key`` of this table."""
        return ConfigError(self._where(key), what, remedy)

    def __contains__(self, key: str) -> bool:
        return key in self._values

    def _take(self, key: str, default: Any, wanted: str = "") -> Any:
        self._seen.add(key)
        if key in self._values:
            return self._values[key]
        if default is ...:
            others = [name for name in self._values if name not in self._seen]
            near = difflib.get_close_matches(key, others, n=1, cutoff=0.7)
            add = f"add {wanted or f'{key} = ...'} to the file"
            remedy = f"is {near[0]!r} meant for it?" if near else add
            raise self.fail(key, "this key is required and missing", remedy)
        return default

    def number(
        self, key: str, low: float, high: float, default: Any = ..., unit: str = ""
    ) -> float:
        """A number within [low, high]."""
        value = self._take(key, default)
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise self.fail(key, f"expected a number{f' in {unit}' if unit else ''}, got {value!r}")
        if not low <= value <= high:
            raise self.fail(
                key,
                f"{value:g}{f' {unit}' if unit else ''} is outside {low:g} to {high:g}",
                "correct the value or the limit it is held against",
            )
        return float(value)

    def integer(self, key: str, low: int, high: int, default: Any = ...) -> int:
        """A whole number within [low, high]."""
        value = self._take(key, default)
        if isinstance(value, bool) or not isinstance(value, int):
            raise self.fail(key, f"expected a whole number, got {value!r}")
        if not low <= value <= high:
            raise self.fail(key, f"{value} is outside {low} to {high}")
        return int(value)

    def text(self, key: str, default: Any = ..., choices: tuple[str, ...] | None = None) -> str:
        """A string, one of ``choices`` where given."""
        value = self._take(key, default)
        if not isinstance(value, str):
            raise self.fail(key, f"expected text in quotes, got {value!r}")
        if choices is not None and value not in choices:
            if key == "protocol" and len(choices) == 1:
                what = f"is {value!r}, and this command runs {choices[0]!r}"
                raise self.fail(key, what, f"`pamrig {value}` runs it, if there is such a test")
            raise self.fail(key, f"{value!r} is not one of {', '.join(choices)}")
        return value

    def ascii(self, key: str, default: Any = ...) -> str:
        """Printable ASCII of up to 200 characters: what a device can be sent or can answer."""
        value = self.text(key, default)
        if not (value.isascii() and (value.isprintable() or not value)) or len(value) > 200:
            raise self.fail(key, f"{value[:40]!r}: expected up to 200 printable ASCII characters")
        return value

    def texts(
        self, key: str, choices: tuple[str, ...], default: Any = ..., least: int = 1
    ) -> tuple[str, ...]:
        """A list of different strings, each one of ``choices``."""
        values = self._take(key, default)
        if not isinstance(values, (list, tuple)) or len(values) < least:
            raise self.fail(key, f"expected a list of {least} or more words, got {values!r}")
        for index, value in enumerate(values):
            if value not in choices:
                raise self.fail(f"{key}[{index}]", f"{value!r} is not one of {', '.join(choices)}")
            if value in values[:index]:
                raise self.fail(f"{key}[{index}]", f"{value!r} is there twice", "remove one")
        return tuple(values)

    def flag(self, key: str, default: Any = ...) -> bool:
        """True or false."""
        value = self._take(key, default)
        if not isinstance(value, bool):
            raise self.fail(key, f"expected true or false, got {value!r}")
        return value

    def numbers(
        self, key: str, low: float, high: float, default: Any = ..., unit: str = "", least: int = 1
    ) -> tuple[float, ...]:
        """A list of numbers, each within [low, high]."""
        values = self._take(key, default)
        if not isinstance(values, (list, tuple)) or len(values) < least:
            raise self.fail(key, f"expected a list of {least} or more numbers, got {values!r}")
        out = []
        for index, value in enumerate(values):
            if isinstance(value, bool) or not isinstance(value, (int, float)):
                raise self.fail(f"{key}[{index}]", f"expected a number, got {value!r}")
            if not low <= value <= high:
                raise self.fail(
                    f"{key}[{index}]",
                    f"{value:g}{f' {unit}' if unit else ''} is outside {low:g} to {high:g}",
                    "correct the value or the rig's limit",
                )
            out.append(float(value))
        return tuple(out)

    def table(self, key: str, optional: bool = False) -> Table:
        """A sub-table; an empty one where it is optional and absent."""
        path = f"{self.path}.{key}" if self.path else key
        value = self._take(key, {} if optional else ..., f"a table [{path}]")
        if not isinstance(value, dict):
            raise self.fail(key, f"expected a table [{path}], got {value!r}")
        return Table(value, self.source, path)

    def row(self, key: str, index: int) -> Table:
        """One table of a list of tables (``[[key]]``)."""
        values = self._take(key, ...)
        value = values[index] if isinstance(values, list) and index < len(values) else None
        if not isinstance(value, dict):
            raise self.fail(f"{key}[{index}]", f"expected a table [[{key}]], got {value!r}")
        return Table(value, self.source, f"{f'{self.path}.' if self.path else ''}{key}[{index}]")

    def raw(self, key: str, default: Any = None) -> Any:
        """The value as parsed, for a table that another package reads."""
        return self._take(key, default)

    def values(self) -> dict[str, Any]:
        """The whole table as parsed, for another package to read."""
        self._seen.update(self._values)
        return dict(self._values)

    def keys(self) -> list[str]:
        """All keys of the table."""
        return list(self._values)

    def finish(self) -> None:
        """Complain about the first key that nothing reads."""
        for key in self._values:
            if key not in self._seen:
                near = difflib.get_close_matches(key, sorted(self._seen), n=1)
                known = ", ".join(sorted(self._seen))
                raise self.fail(
                    key,
                    "unknown key",
                    f"did you mean {near[0]!r}?" if near else f"known here: {known}",
                )


def find_config(name: str, folder: str) -> tuple[str, str]:
    """Text and display name of a TOML file given as a path or as a shipped name.

    Args:
        name: a path to a file, or the name of one shipped in ``configs/<folder>``.
        folder: "rigs" or "protocols".

    Raises:
        ConfigError: neither exists, or it cannot be read as text.
    """
    path = Path(name)
    if path.suffix == ".toml" or os.path.exists(path):  # Path.exists raises for a long name
        try:
            return tomlfile.read_text(path), str(path)
        except (OSError, UnicodeDecodeError) as error:
            why = getattr(error, "strerror", None) or error
            raise ConfigError(str(path), f"cannot be read: {why}", "check the path") from None
    shipped = importlib.resources.files("configs") / folder
    names = sorted(e.name[:-5] for e in shipped.iterdir() if e.name.endswith(".toml"))
    if name in names:
        text = (shipped / f"{name}.toml").read_text(encoding="utf-8")
        return text, f"configs/{folder}/{name}.toml"
    raise ConfigError(
        name,
        f"no such file, and no shipped {folder[:-1]} of that name",
        f"shipped: {', '.join(names)}",
    )


def load_toml(name: str, folder: str) -> Table:
    """Parse a TOML file given as a path or as a shipped name."""
    text, source = find_config(name, folder)
    try:
        return Table(tomlfile.loads(text), source)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(source, f"is not valid TOML: {error}", "correct that line") from None
