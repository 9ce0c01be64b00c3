"""A disk that is full, slow, read-only or broken, under the real files of a run."""

from __future__ import annotations

import contextlib
import errno
import os
import random
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import daq.record.disk
import daq.record.sealed

if TYPE_CHECKING:
    from .kinds import Fault

RESERVE = 65536
PAUSE = 4.0
"""Times a long write's length until the next one. On the virtual clock the record writes without a
thread of its own, and each long write brings new data to write: a disk that is slower than the
data would never come to an end there. With the threads of real time it does, as
``tests/test_daq_record.py`` shows."""


class FaultyDisk:
    """Stands between the record and the operating system's write and fsync.

    Attributes:
        stall: lets time pass, in bench seconds, as a write that takes long does; now_s tells it.
        die: ends the process; with ``die_in_write`` it is called in the midst of the next write.
    """

    def __init__(self, rng: random.Random) -> None:
        self.rng = rng
        self.stall: Callable[[float], None] = lambda seconds: None
        self.now_s: Callable[[], float] = lambda: 0.0
        self.die: Callable[[], None] = lambda: None
        self.die_in_write = False
        self._on: Fault | None = None
        self._room = 0
        self._next_s = 0.0
        self._stalling = False
        self._write, self._sync = os.write, os.fsync

    def begin(self, fault: Fault) -> None:
        """From now on."""
        self._on = fault
        self._room = self.rng.randrange(2000)

    def end(self, fault: Fault) -> None:
        """All is well again; what was refused stays refused."""
        if self._on is fault:
            self._on = None

    @contextlib.contextmanager
    def fitted(self) -> Iterator[None]:
        """In force while the context lasts."""
        everything, real_sync = daq.record.sealed.write_all, os.fsync
        daq.record.sealed.write_all = daq.record.disk.write_all = self._write_all
        os.fsync = self._fsync
        try:
            yield
        finally:
            daq.record.sealed.write_all = daq.record.disk.write_all = everything
            os.fsync = real_sync

    def _fsync(self, fd: int) -> None:
        fault = self._on
        if fault is not None and fault.kind == "sync fails":
            fault.hits += 1
            fault.must_tell = 1
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        self._sync(fd)

    def _write_all(self, fd: int, data: bytes) -> None:
        fault = self._on
        if self.die_in_write:
            self._put(fd, data[: len(data) // 2])
            self.die()
        if fault is not None:
            self._meet(fault, fd, data)
        self._put(fd, data)

    def _meet(self, fault: Fault, fd: int, data: bytes) -> None:
        if fault.kind == "slow":
            fault.hits += 1
            seconds = 0.02 + 0.5 * fault.size
            fault.must_tell = int(seconds > 0.45)
            if self.now_s() >= self._next_s and not self._stalling:
                self._stalling = True  # what else is written meanwhile waits with it
                self.stall(seconds)
                self._stalling = False
                self._next_s = self.now_s() + PAUSE * seconds
        elif fault.kind == "full" and self._room < len(data):
            self._put(fd, data[: self._room])
            self._refuse(fault, errno.ENOSPC, room=RESERVE)
        elif fault.kind == "full":
            self._room -= len(data)
        elif fault.kind == "read-only":
            self._refuse(fault, errno.EROFS)
        elif fault.kind == "one error":
            self._on = None
            self._refuse(fault, errno.EIO)

    def _refuse(self, fault: Fault, code: int, room: int = 0) -> None:
        first = not fault.hits
        fault.hits += 1
        fault.must_tell = 1
        self._room = room if first else 0  # the record gives back its reserve
        raise OSError(code, os.strerror(code))

    def _put(self, fd: int, data: bytes) -> None:
        while data:
            data = data[self._write(fd, data) :]
