"""Safe reading of TOML files, also from unknown sources.

Raises the same errors as :mod:`tomllib` and the operating system, for some more reasons: an endless
file (a device, a pipe), a very large file, a key with thousands of parts (the parser needs
quadratic time for it), values nested too deep, integers beyond 64 bits.
"""

from __future__ import annotations

import difflib
import errno
import os
import re
import stat
import tomllib
from collections.abc import Iterable
from importlib import resources
from pathlib import Path
from typing import Any

from plant.errors import PlantError

LARGEST = 4 << 20
"""Bytes; about a hundred times the largest file that users or this program write."""
DEEPEST = 32
_PARTS = re.compile(r"[=,\[\]{}\n]")
_WHOLE = 2**63


def read_text(path: Path | str) -> str:
    """The text of a regular file.

    Raises:
        OSError: it cannot be read, is not a regular file, or has more than ``LARGEST`` bytes.
        UnicodeDecodeError: it is not UTF-8.
    """
    return read_bytes(path, LARGEST).decode("utf-8").replace("\r\n", "\n")


def read_bytes(path: Path | str, at_most: int) -> bytes:
    """The bytes of a regular file; see :func:`read_text`. Does not wait for a pipe."""
    if "\0" in str(path):
        raise OSError(errno.EINVAL, "a file name cannot contain a zero byte", str(path))
    fd = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    with os.fdopen(fd, "rb") as file:
        about = os.fstat(fd)
        if stat.S_ISDIR(about.st_mode):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
        if not stat.S_ISREG(about.st_mode):
            raise OSError(errno.EINVAL, "is not a regular file", str(path))
        if about.st_size > at_most:
            what = f"holds {about.st_size} bytes, more than {at_most}"
            raise OSError(errno.EFBIG, what, str(path))
        return file.read(about.st_size)  # Python allocates as much memory as requested


def loads(text: str) -> dict[str, Any]:
    """Tables and values of a TOML text.

    Raises:
        tomllib.TOMLDecodeError: it is not TOML, or exceeds the limits of this module.
    """
    for line in text.split("\n"):
        if line.count(".") > DEEPEST and not line.lstrip().startswith("#"):
            for part in _PARTS.split(line):
                if part.count(".") > 2 * DEEPEST:
                    raise tomllib.TOMLDecodeError(f"a key has {part.count('.') + 1} parts")
    try:
        table = tomllib.loads(text)
    except RecursionError:
        raise tomllib.TOMLDecodeError("values are nested too deep") from None
    except tomllib.TOMLDecodeError:
        raise
    except (ValueError, OverflowError) as error:  # a number that is too long, an invalid date
        raise tomllib.TOMLDecodeError(str(error)) from None
    _check(table)
    return table


def _check(table: dict[str, Any]) -> None:
    """Check for values deeper than ``DEEPEST`` and integers beyond 64 bits (the limit of TOML)."""
    level: list[Any] = [table]
    for _ in range(DEEPEST):
        inner: list[Any] = []
        for value in level:
            if isinstance(value, dict):
                inner.extend(value.values())
            elif isinstance(value, list):
                inner.extend(value)
            elif isinstance(value, int) and not -_WHOLE <= value < _WHOLE:
                raise tomllib.TOMLDecodeError("an integer is beyond 64 bits")
        if not inner:
            return
        level = inner
    raise tomllib.TOMLDecodeError(f"values are nested more than {DEEPEST} deep")


def load_table(
    source: str | Path, folder: str, what: str, error: type[PlantError] = PlantError
) -> tuple[dict[str, Any], str]:
    """A table from a TOML file, or from a shipped file of ``configs/plant/FOLDER`` by name.

    Returns the table and its origin for messages ("finger file x.toml").

    Raises:
        PlantError: of class `error`; names the file.
    """
    path = Path(source)
    if path.suffix != ".toml" and not os.path.exists(path):
        known = shipped_names(folder)
        if str(source) not in known:
            near = difflib.get_close_matches(str(source), known, n=1)
            hint = f"did you mean {near[0]}?" if near else "give a .toml file or one of these"
            raise error(
                f"{what} {str(source)!r}: neither a file nor shipped; {hint} ({', '.join(known)})"
            )
        entry = resources.files("configs").joinpath("plant", folder, f"{source}.toml")
        text, origin = entry.read_text(encoding="utf-8"), f"shipped {what} {source}.toml"
    else:
        origin = f"{what} file {path}"
        try:
            text = read_text(path)
        except (OSError, UnicodeDecodeError) as problem:
            raise error(f"{origin}: cannot be read ({problem}); check the path") from problem
    try:
        return loads(text), origin
    except tomllib.TOMLDecodeError as problem:
        raise error(f"{origin}: not valid TOML ({problem}); correct that line") from problem


def shipped_names(folder: str) -> list[str]:
    """Names of the shipped files in ``configs/plant/FOLDER``, sorted."""
    entries = resources.files("configs").joinpath("plant", folder).iterdir()
    return sorted(e.name.removesuffix(".toml") for e in entries if e.name.endswith(".toml"))


def check_keys(
    table: Iterable[str], known: Iterable[str], origin: str, error: type[PlantError] = PlantError
) -> None:
    """Raise `error` for a key that is not known, with the nearest known key."""
    known = list(known)
    for key in table:
        if key not in known:
            near = difflib.get_close_matches(key, known, n=1)
            hint = f"did you mean {near[0]}?" if near else f"known keys: {', '.join(known)}"
            raise error(f"{origin}: unknown key {key!r}; {hint}")


def number_in_range(
    value: object,
    key: str,
    low: float,
    high: float,
    origin: str,
    error: type[PlantError] = PlantError,
) -> float:
    """A number from low to high, both included. Raises `error` for anything else."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise error(
            f"{origin}: {key} = {value!r} is a {type(value).__name__}; "
            f"expected a number from {low:g} to {high:g}"
        )
    if not low <= value <= high:  # also true for nan
        raise error(f"{origin}: {key} = {value!r} is out of range; allowed {low:g} to {high:g}")
    return float(value)
