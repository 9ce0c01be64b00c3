"""TOML files, also those of strangers: plain files of a sane size, nested no deeper than a person.

The same errors as :mod:`tomllib` and the operating system, for a few more reasons: a file that is
endless (a device, a pipe) or huge, a key of a thousand parts (the parser takes the square of that
in time), values nested without end, whole numbers beyond 64 bits.
"""

from __future__ import annotations

import errno
import os
import re
import stat
import tomllib
from pathlib import Path
from typing import Any

LARGEST = 4 << 20
"""Bytes; the longest file that a person or this program writes is a hundredth of it."""
DEEPEST = 32
_PARTS = re.compile(r"[=,\[\]{}\n]")
_WHOLE = 2**63


def read_text(path: Path | str, at_most: int = LARGEST) -> str:
    """The text of a plain file.

    Raises:
        OSError: it cannot be read, is no plain file, or holds more than ``at_most`` bytes.
        UnicodeDecodeError: it is not UTF-8.
    """
    return read_bytes(path, at_most).decode("utf-8").replace("\r\n", "\n")


def read_bytes(path: Path | str, at_most: int) -> bytes:
    """The bytes of a plain file; see :func:`read_text`. A pipe is not waited for."""
    if "\0" in str(path):
        raise OSError(errno.EINVAL, "no name has a zero byte in it", str(path))
    fd = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    with os.fdopen(fd, "rb") as file:
        about = os.fstat(fd)
        if stat.S_ISDIR(about.st_mode):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
        if not stat.S_ISREG(about.st_mode):
            raise OSError(errno.EINVAL, "is no plain file", str(path))
        if about.st_size > at_most:
            what = f"holds {about.st_size} bytes, more than {at_most}"
            raise OSError(errno.EFBIG, what, str(path))
        return file.read(about.st_size)  # asked for more, Python sets that much memory aside


def loads(text: str) -> dict[str, Any]:
    """Tables and values of a TOML text.

    Raises:
        tomllib.TOMLDecodeError: it is not TOML, or goes beyond the bounds of this module.
    """
    for line in text.split("\n"):
        if line.count(".") > DEEPEST and not line.lstrip().startswith("#"):
            for part in _PARTS.split(line):
                if part.count(".") > 2 * DEEPEST:
                    raise tomllib.TOMLDecodeError(f"a key has {part.count('.') + 1} parts")
    try:
        table = tomllib.loads(text)
    except RecursionError:
        raise tomllib.TOMLDecodeError("values are nested without end") from None
    except tomllib.TOMLDecodeError:
        raise
    except (ValueError, OverflowError) as error:  # a number too long to be read, a strange date
        raise tomllib.TOMLDecodeError(str(error)) from None
    _check(table)
    return table


def _check(table: dict[str, Any]) -> None:
    """No value deeper than ``DEEPEST``, no whole number beyond 64 bits (as TOML itself asks)."""
    level: list[Any] = [table]
    for _ in range(DEEPEST):
        inner: list[Any] = []
        for value in level:
            if isinstance(value, dict):
                inner.extend(value.values())
            elif isinstance(value, list):
                inner.extend(value)
            elif isinstance(value, int) and not -_WHOLE <= value < _WHOLE:
                raise tomllib.TOMLDecodeError("a whole number is beyond 64 bits")
        if not inner:
            return
        level = inner
    raise tomllib.TOMLDecodeError(f"values are nested more than {DEEPEST} deep")
