"""A lock on an open file that goes with its process, however that ends."""

from __future__ import annotations

import os
import sys


def try_lock(fd: int, at: int = 0) -> bool:
    """Whether the file could be had for this process at once; closing it gives it back.

    Args:
        fd: an open file.
        at: the byte that stands for the lock where locks are of bytes (Windows): others may not
            read or write it meanwhile.
    """
    if sys.platform == "win32":
        import msvcrt

        try:
            os.lseek(fd, at, os.SEEK_SET)
            msvcrt.locking(fd, msvcrt.LK_NBLCK, 1)
            os.lseek(fd, 0, os.SEEK_SET)
        except OSError:
            return False
        return True
    import fcntl

    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True
