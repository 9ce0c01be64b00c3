"""File lock that the operating system releases when the process ends."""

from __future__ import annotations

import os
import sys


def try_lock(fd: int, at: int = 0) -> bool:
    """Lock an open file for this process; False if another process holds the lock.

    Closing the file releases the lock. ``at`` is the byte to lock where locks cover bytes
    (Windows): other processes can neither read nor write that byte.
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
