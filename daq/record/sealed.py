"""JSON that knows when it has been damaged.

Two forms, both plain JSON for any other reader:

* a *line* is one object on one line whose last member is ``"crc"``;
* a *sealed file* is one indented object whose last member is ``"crc"``.

The CRC-32 (zlib) covers the exact bytes before that last member; what follows it is
fixed to the byte. So every bit of a line or file, its end of line and the CRC itself
included, is either covered or compared.
"""

from __future__ import annotations

import json
import math
import os
import sys
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

_LINE_TAIL = len(',"crc":"00000000"}\n')
_FILE_TAIL = len(',\n  "crc": "00000000"\n}\n')


class SealError(ValueError):
    """A line or file does not carry the CRC of its own bytes."""


def plain(value: Any) -> Any:
    """``value`` as JSON can hold it: numpy scalars and arrays unpacked, NaN and inf as null."""
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


def _object(text: bytes) -> Any:
    try:
        return json.loads(text)
    except RecursionError:
        raise SealError("is nested without end") from None


def _refuse_crc(fields: dict[str, Any]) -> None:
    if "crc" in fields:
        raise ValueError("the name 'crc' is taken by the seal itself")


def seal_text(text: str) -> bytes:
    """Seal one JSON object already written out as ``{...`` *without* its closing brace."""
    body = text.encode()
    return b'%s,"crc":"%08x"}\n' % (body, zlib.crc32(body))


def seal_line(fields: dict[str, Any]) -> bytes:
    """One sealed line, newline included, members in the order given.

    Raises:
        ValueError: if there is no member, or one is called ``crc``.
    """
    _refuse_crc(fields)
    if not fields:
        raise ValueError("an empty line cannot be sealed")
    try:
        text = json.dumps(fields, separators=(",", ":"), allow_nan=False, ensure_ascii=False)
    except (TypeError, ValueError):
        text = json.dumps(plain(fields), separators=(",", ":"), ensure_ascii=False)
    return seal_text(text[:-1])


def open_line(line: bytes) -> dict[str, Any]:
    """The members of one sealed line (newline included), without its CRC.

    Raises:
        SealError: if a single bit of it is not as it was written.
    """
    body = line[:-_LINE_TAIL]
    if not body or line[-_LINE_TAIL:] != b',"crc":"%08x"}\n' % zlib.crc32(body):
        raise SealError("does not carry the CRC of its own bytes")
    fields = _object(body + b"}")
    if not isinstance(fields, dict):
        raise SealError("is not a JSON object")
    return fields


class Line(NamedTuple):
    """One line of a file: where it starts, its bytes, its members (None if damaged)."""

    offset: int
    raw: bytes
    fields: dict[str, Any] | None


def read_lines(data: bytes) -> Iterator[Line]:
    """Every line of ``data`` in order, damaged and torn ones with ``fields`` None."""
    offset = 0
    for raw in data.splitlines(keepends=True) if b"\r" not in data else _split(data):
        try:
            fields: dict[str, Any] | None = open_line(raw)
        except ValueError:
            fields = None
        yield Line(offset, raw, fields)
        offset += len(raw)


def _split(data: bytes) -> Iterator[bytes]:
    start = 0
    while start < len(data):
        end = data.find(b"\n", start) + 1 or len(data)
        yield data[start:end]
        start = end


def seal_file(fields: dict[str, Any]) -> bytes:
    """A whole file of sealed, indented JSON."""
    _refuse_crc(fields)
    if not fields:
        raise ValueError("an empty file cannot be sealed")
    text = json.dumps(plain(fields), indent=2, ensure_ascii=False)
    body = text.removesuffix("\n}").encode()
    return b'%s,\n  "crc": "%08x"\n}\n' % (body, zlib.crc32(body))


def open_file(data: bytes) -> dict[str, Any]:
    """The members of a sealed file, without its CRC.

    Raises:
        SealError: if a single bit of it is not as it was written.
    """
    body = data[:-_FILE_TAIL]
    if not body or data[-_FILE_TAIL:] != b',\n  "crc": "%08x"\n}\n' % zlib.crc32(body):
        raise SealError("does not carry the CRC of its own bytes")
    fields = _object(body + b"\n}")
    if not isinstance(fields, dict):
        raise SealError("is not a JSON object")
    return fields


def write_sealed(path: Path, fields: dict[str, Any], durable: bool = True) -> bytes:
    """Write a sealed file so that at no moment a partial one bears its name.

    Returns:
        the bytes written.
    """
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
    """Make names in ``folder`` survive a power cut (where the system can)."""
    if sys.platform == "win32":
        return
    fd = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)
