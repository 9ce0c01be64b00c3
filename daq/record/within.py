"""Reads files of a run folder that may be a stranger's: inside it, plain, and of a sane size.

A manifest or index names files. Such a name may not lead out of the folder (``..``, an absolute
path, a link), nor to a device or pipe that never ends, nor to a file that only claims its size.
"""

from __future__ import annotations

import os
import stat
from pathlib import Path, PurePosixPath, PureWindowsPath

from daq.errors import RecordError

LARGEST_TEXT = 256 << 20
"""Bytes of run.json, events and other text; a day of events takes a tenth of it."""
LARGEST_INDEX = 1 << 30
"""Bytes of an index: a day at 1 kHz takes two thirds."""
LARGEST_BULK = 2 << 30
"""Bytes of one segment, file of frames or wire dump."""


def path_inside(root: Path, name: str) -> Path:
    """The path of a file of a folder, which it does not leave.

    Raises:
        RecordError: the name is absolute, climbs out, or a link leads out.
    """
    parts = PurePosixPath(name)
    climbs = ".." in parts.parts or ".." in PureWindowsPath(name).parts or "\0" in name
    if not name or climbs or parts.is_absolute() or PureWindowsPath(name).anchor:
        raise RecordError(str(root), f"names a file outside itself: {name!r}", _REMEDY)
    path = root / name
    try:
        real, home = path.resolve(), root.resolve()
    except (OSError, RuntimeError) as error:  # links that go round in circles
        raise RecordError(str(path), f"cannot be followed: {error}", _REMEDY) from None
    if not real.is_relative_to(home):
        raise RecordError(str(path), f"is a link that leads to {real}", _REMEDY)
    return path


def read_inside(root: Path, name: str, at_most: int = LARGEST_TEXT) -> bytes:
    """All bytes of a plain file of a folder; a pipe or device is not opened to the end.

    Raises:
        RecordError: it leads out of the folder, is no plain file, cannot be read, or is larger
            than ``at_most``.
    """
    path = path_inside(root, name)
    try:
        fd = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
        with os.fdopen(fd, "rb") as file:
            about = os.fstat(fd)
            if not stat.S_ISREG(about.st_mode):
                raise RecordError(str(path), "is no plain file, not read", _REMEDY)
            if about.st_size > at_most:
                what = f"has {about.st_size} bytes, more than the {at_most} that one may have"
                raise RecordError(str(path), f"{what}, not read", _REMEDY)
            return file.read(about.st_size)  # asked for more, Python sets that much memory aside
    except OSError as error:
        raise RecordError(str(path), f"cannot be read: {error.strerror}") from None


_REMEDY = "pamrig did not write this record so; do not trust it"
