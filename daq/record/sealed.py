"""JSON with a checksum.

Two forms, both plain JSON for any other reader:

* a *line* is one object on one line whose last member is ``"crc"``;
* a *sealed file* is one indented object whose last member is ``"crc"``.

The CRC-32 (zlib) covers the exact bytes before that last member. The bytes after it are fixed.
A reader therefore detects a change of any bit, including the end of line and the CRC itself.
"""

from __future__ import annotations

import io
import json
import math
import os
import re
import sys
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

_LINE_TAIL = b',"crc":"%08x"}\n'
_FILE_TAIL = b',\n  "crc": "%08x"\n}\n'


_RARE = re.compile(rb"\d{19}|[eE]\+?\d{3}|NaN|Infinity|\\u[dD]")
"""Where a value may be that :func:`_writable` refuses; few lines have any."""


class SealError(ValueError):
    """The CRC of a line or file does not match its bytes."""


def plain(value: Any) -> Any:
    """Convert to JSON types: numpy scalars and arrays to numbers and lists, NaN and inf to null."""
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple, set, frozenset)):
        return [plain(v) for v in (sorted(value) if isinstance(value, (set, frozenset)) else value)]
    if value is None or isinstance(value, (bool, int, str)):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    raise TypeError(f"{type(value).__name__} cannot be stored as JSON: {value!r}")


def _seal(body: bytes, tail: bytes) -> bytes:
    return body + tail % zlib.crc32(body)


def _open(data: bytes, tail: bytes) -> dict[str, Any]:
    body = data[: -len(tail % 0)]
    if not body or data != _seal(body, tail):
        raise SealError("the CRC does not match the bytes")
    try:
        fields = json.loads(body + b"}")
    except RecursionError:
        raise SealError("the JSON is nested too deeply") from None
    if not isinstance(fields, dict):
        raise SealError("not a JSON object")
    if _RARE.search(body) and not _writable(fields):
        raise SealError("a number or text that this format cannot hold")
    return fields


def _writable(value: Any) -> bool:
    """True for values as :func:`seal_file` writes them: finite, integers of 64 bits, Unicode."""
    if isinstance(value, dict):
        return all(_writable(key) and _writable(inner) for key, inner in value.items())
    if isinstance(value, list):
        return all(map(_writable, value))
    if isinstance(value, str):
        return not any(0xD800 <= ord(character) <= 0xDFFF for character in value)
    if isinstance(value, float):
        return math.isfinite(value)
    return not isinstance(value, int) or -(2**63) <= value < 2**64


def _check_fields(fields: dict[str, Any]) -> None:
    if not fields or "crc" in fields:
        raise ValueError("a sealed object needs at least one member; the name 'crc' is reserved")


def seal_text(text: str) -> bytes:
    """Seal a JSON object given as text *without* its closing brace."""
    return _seal(text.encode(), _LINE_TAIL)


def seal_line(fields: dict[str, Any]) -> bytes:
    """One sealed line with newline, members in the given order.

    Raises:
        ValueError: there is no member, or one has the name ``crc``.
    """
    _check_fields(fields)
    try:
        text = json.dumps(fields, separators=(",", ":"), allow_nan=False, ensure_ascii=False)
    except (TypeError, ValueError):
        text = json.dumps(plain(fields), separators=(",", ":"), ensure_ascii=False)
    return seal_text(text[:-1])


def open_line(line: bytes) -> dict[str, Any]:
    """The members of a sealed line (with newline), without the CRC.

    Raises:
        SealError: a bit of the line has changed.
    """
    return _open(line, _LINE_TAIL)


class Line(NamedTuple):
    """One line of a file: byte offset, bytes, members (None if damaged)."""

    offset: int
    raw: bytes
    fields: dict[str, Any] | None

    @property
    def torn(self) -> bool:
        """True for a damaged line without newline: the write was cut off."""
        return self.fields is None and not self.raw.endswith(b"\n")


def read_lines(data: bytes) -> Iterator[Line]:
    """Every line of ``data`` in order; damaged lines have ``fields`` None."""
    offset = 0
    for raw in io.BytesIO(data):
        try:
            fields: dict[str, Any] | None = open_line(raw)
        except ValueError:
            fields = None
        yield Line(offset, raw, fields)
        offset += len(raw)


def seal_file(fields: dict[str, Any]) -> bytes:
    """The bytes of a sealed, indented JSON file."""
    _check_fields(fields)
    text = json.dumps(plain(fields), indent=2, ensure_ascii=False)
    return _seal(text.removesuffix("\n}").encode(), _FILE_TAIL)


def open_file(data: bytes) -> dict[str, Any]:
    """The members of a sealed file, without the CRC.

    Raises:
        SealError: a bit of the file has changed.
    """
    return _open(data, _FILE_TAIL)


def sums(data: bytes) -> dict[str, Any]:
    """Size and CRC-32 of a file, as ``final.json`` and other lists of files state them."""
    return {"size": len(data), "crc32": f"{zlib.crc32(data):08x}"}


def write_sealed(path: Path, fields: dict[str, Any], durable: bool = True) -> bytes:
    """Write a sealed file atomically (write, then rename); returns its bytes."""
    data = seal_file(fields)
    partial = path.with_name(path.name + ".partial")
    with open(partial, "wb", buffering=0) as out:
        write_all(out.fileno(), data)
        if durable:
            os.fsync(out.fileno())
    os.replace(partial, path)
    if durable:
        sync_folder(path.parent)
    return data


def write_all(fd: int, data: bytes) -> None:
    """Write every byte of ``data``, or raise OSError."""
    done = os.write(fd, data)
    while done < len(data):
        done += os.write(fd, data[done:])


def sync_folder(folder: Path) -> None:
    """Make the names in ``folder`` survive a power cut (not available on Windows)."""
    if sys.platform == "win32":
        return
    fd = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)
