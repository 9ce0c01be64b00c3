"""Safe reading of run folders from untrusted sources.

A manifest or index contains file names. Such a name must not lead out of the folder (``..``, an
absolute path, a link) or to a device or pipe. The file size is limited.
"""

from __future__ import annotations

import contextlib
import os
import stat
import zlib
from collections.abc import Iterator
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any

from daq.errors import RecordError

LARGEST_TEXT = 256 << 20
"""Bytes of run.json, events and other text; one day of events needs a tenth of it."""
LARGEST_INDEX = 1 << 30
"""Bytes of an index; one day at 1 kHz needs two thirds of it."""
LARGEST_BULK = 2 << 30
"""Bytes of one segment, frames file or wire dump."""
MOST_FILES = 100_000
_REMEDY = "pamrig did not write this record; do not trust it"


def path_inside(root: Path, name: str) -> Path:
    """The path of the file ``name`` in a folder.

    Raises:
        RecordError: the name is absolute or contains ``..``, or it, or a folder on its way, is a
            link: no record contains one.
    """
    parts = PurePosixPath(name)
    climbs = ".." in parts.parts or ".." in PureWindowsPath(name).parts or "\0" in name
    if not name or climbs or parts.is_absolute() or PureWindowsPath(name).anchor:
        raise RecordError(str(root), f"refers to a file outside of itself: {name!r}", _REMEDY)
    path = root
    for part in parts.parts:
        path = path / part
        if os.path.islink(path):  # False for a name that is too long; opening it fails
            raise RecordError(str(path), "is a link, not read; no record contains one", _REMEDY)
    return path


@contextlib.contextmanager
def open_inside(root: Path, name: str, at_most: int = LARGEST_TEXT) -> Iterator[tuple[Any, int]]:
    """A regular file in a folder, opened for reading, and its size in bytes.

    Every file of a record is opened here: nothing else follows a link, waits for a pipe, or reads a
    device or a file without an end.

    Raises:
        RecordError: the file is outside of the folder, a link, not a regular file, unreadable, or
            larger than ``at_most``.
    """
    path = path_inside(root, name)
    flags = ("O_NONBLOCK", "O_BINARY", "O_NOFOLLOW", "O_CLOEXEC")
    try:
        fd = os.open(path, os.O_RDONLY | sum(getattr(os, flag, 0) for flag in flags))
        with os.fdopen(fd, "rb") as file:
            about = os.fstat(fd)
            if not stat.S_ISREG(about.st_mode):
                raise RecordError(str(path), "is not a regular file, not read", _REMEDY)
            if about.st_size > at_most:
                what = f"has {about.st_size} bytes, the limit is {at_most}, not read"
                raise RecordError(str(path), what, _REMEDY)
            yield file, about.st_size
    except OSError as error:
        gone = isinstance(error, FileNotFoundError)
        why = "missing" if gone else f"cannot be read: {error.strerror or error}"
        raise RecordError(str(path), why) from None


def read_inside(root: Path, name: str, at_most: int = LARGEST_TEXT) -> bytes:
    """All bytes of a regular file in a folder; raises as :func:`open_inside`."""
    with open_inside(root, name, at_most) as (file, size):
        return bytes(file.read(size))  # Python allocates as much memory as requested


def read_part(root: Path, name: str, offset: int, length: int) -> bytes:
    """Up to ``length`` bytes from ``offset`` on; raises as :func:`open_inside`."""
    with open_inside(root, name, LARGEST_BULK) as (file, size):
        file.seek(min(offset, size))
        return bytes(file.read(max(0, min(length, size - offset))))


def size_inside(root: Path, name: str) -> int:
    """Size of a regular file in bytes; raises as :func:`open_inside`."""
    with open_inside(root, name, LARGEST_BULK) as (_, size):
        return int(size)


def sum_inside(root: Path, name: str, first: int | None = None) -> tuple[int, str]:
    """Size of a regular file and CRC-32 of it, or of its first bytes, in hexadecimal digits.

    Raises as :func:`open_inside`.
    """
    with open_inside(root, name, LARGEST_BULK) as (file, size):
        crc, left = 0, size if first is None else min(size, first)
        while left and (block := file.read(min(left, 1 << 20))):
            crc = zlib.crc32(block, crc)
            left -= len(block)
        return int(size), f"{crc:08x}"


def names_inside(root: Path) -> Iterator[tuple[str, int]]:
    """Name and size of everything in a folder but plain folders, sorted; links are not followed.

    Raises:
        RecordError: there are more than ``MOST_FILES``.
    """
    found: list[tuple[str, int]] = []
    waiting = [root]
    while waiting:
        folder = waiting.pop()
        with contextlib.suppress(OSError), os.scandir(folder) as entries:
            for entry in entries:
                if entry.is_dir(follow_symlinks=False):
                    waiting.append(Path(entry.path))
                    continue
                name = Path(entry.path).relative_to(root).as_posix()
                found.append((name, entry.stat(follow_symlinks=False).st_size))
                if len(found) > MOST_FILES:
                    raise RecordError(str(root), f"has more than {MOST_FILES} files", _REMEDY)
    yield from sorted(found)
