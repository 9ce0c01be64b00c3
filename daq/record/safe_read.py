"""Safe reading of run folders from untrusted sources.

A manifest or index contains file names. Such a name must not lead out of the folder (``..``, an
absolute path, a link) or to a device or pipe. The file size is limited.
"""

from __future__ import annotations

import os
import stat
from pathlib import Path, PurePosixPath, PureWindowsPath

from daq.errors import RecordError

LARGEST_TEXT = 256 << 20
"""Bytes of run.json, events and other text; one day of events needs a tenth of it."""
LARGEST_INDEX = 1 << 30
"""Bytes of an index; one day at 1 kHz needs two thirds of it."""
LARGEST_BULK = 2 << 30
"""Bytes of one segment, frames file or wire dump."""
_REMEDY = "pamrig did not write this record; do not trust it"


def path_inside(root: Path, name: str) -> Path:
    """The path of the file ``name`` in a folder.

    Raises:
        RecordError: the name is absolute or contains ``..``, or a link leads out of the folder.
    """
    parts = PurePosixPath(name)
    climbs = ".." in parts.parts or ".." in PureWindowsPath(name).parts or "\0" in name
    if not name or climbs or parts.is_absolute() or PureWindowsPath(name).anchor:
        raise RecordError(str(root), f"refers to a file outside of itself: {name!r}", _REMEDY)
    path = root / name
    try:
        real, home = path.resolve(), root.resolve()
    except (OSError, RuntimeError) as error:  # circular links
        raise RecordError(str(path), f"the path cannot be resolved: {error}", _REMEDY) from None
    if not real.is_relative_to(home):
        raise RecordError(str(path), f"is a link to {real}, outside of the folder", _REMEDY)
    return path


def read_inside(root: Path, name: str, at_most: int = LARGEST_TEXT) -> bytes:
    """All bytes of a regular file in a folder.

    Raises:
        RecordError: the file is outside of the folder, not a regular file, unreadable, or larger
            than ``at_most``.
    """
    path = path_inside(root, name)
    try:
        fd = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
        with os.fdopen(fd, "rb") as file:
            about = os.fstat(fd)
            if not stat.S_ISREG(about.st_mode):
                raise RecordError(str(path), "is not a plain file, not read", _REMEDY)
            if about.st_size > at_most:
                what = f"has {about.st_size} bytes, the limit is {at_most}, not read"
                raise RecordError(str(path), what, _REMEDY)
            return file.read(about.st_size)  # Python allocates as much memory as requested
    except OSError as error:
        raise RecordError(str(path), f"cannot be read: {error.strerror}") from None
