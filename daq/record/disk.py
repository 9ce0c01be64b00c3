"""Appended files, written at once, synced off the caller's path.

Three lives, so that no slow one holds up a quicker one: the caller encodes and queues;
the *writer* hands bytes to the operating system as they come (they then survive a kill
of this process); the *syncer* pushes them to the medium once a second, or at once when
asked (they then survive a power cut). Without threads all of it happens in the caller.
"""

from __future__ import annotations

import contextlib
import errno
import os
import queue
import threading
import time
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from daq.errors import RecordError
from daq.record.sealed import sync_folder, write_all

RESERVE_NAME = "reserve.zero"
RESERVE_BYTES = 65536
SYNC_PERIOD_S = 1.0
QUEUE_BYTES = 64 << 20
JOIN_S = 30.0
OWED_BYTES = 1 << 20
"""So much of what is vital is kept for a disk that may take it later."""

_REMEDIES = {
    errno.ENOSPC: "free some disk space or choose another runs folder; all before this is readable",
    errno.EFBIG: "the system limits the size of a file (ulimit -f); lift it or use another disk",
    errno.EROFS: "the file system is read-only; choose another runs folder",
    errno.EACCES: "choose a runs folder that you may write to",
    errno.EIO: "the disk reports a fault; copy the record away and replace the disk",
}
_REMEDIES[getattr(errno, "EDQUOT", errno.ENOSPC)] = _REMEDIES[errno.ENOSPC]


def disk_error(where: Path | str, doing: str, error: OSError) -> RecordError:
    """An OSError met while writing, as the operator should read it."""
    remedy = _REMEDIES.get(error.errno or 0, "check the disk and the permissions of this folder")
    return RecordError(str(where), f"{doing}: {error.strerror or error}", remedy)


class _File:
    """One appended file with the CRC of all that was written to it."""

    def __init__(self, path: Path) -> None:
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND | getattr(os, "O_BINARY", 0)
        self.path = path
        self.fd = os.open(path, flags, 0o644)
        self.size = 0
        self.crc = 0

    def write(self, data: bytes) -> None:
        try:
            write_all(self.fd, data)
        except OSError:
            with contextlib.suppress(OSError):
                os.truncate(self.path, self.size)  # no torn chunk, and room for final.json
            raise
        self.size += len(data)
        self.crc = zlib.crc32(data, self.crc)


class Disk:
    """All the files of one run folder while it is being written.

    Args:
        root: the run folder, which exists.
        durable: fsync (once a second, and at once where asked); else only at close.
        threaded: write and sync in threads of their own.

    Attributes:
        failed: the first error met, None while all is well. After it bulk data are
            refused; lines marked ``vital`` are still tried, those refused before them first.
        discarded_bytes: how much was queued and could not be written.
    """

    def __init__(self, root: Path, durable: bool, threaded: bool) -> None:
        self.root = root
        self.durable = durable
        self.threaded = threaded
        self.failed: RecordError | None = None
        self.discarded_bytes = 0
        self._files: dict[str, _File] = {}
        self._dirty: set[_File] = set()
        self._ended: set[_File] = set()
        self._grown: set[Path] = set()
        self._sync_lock = threading.Lock()
        self._sync_wanted = threading.Event()
        self._stop = False
        self._owed: list[tuple[str, bytes]] = []
        self._queued = 0
        self._written = 0
        self._synced_s = time.monotonic()
        self._jobs: queue.SimpleQueue[
            tuple[str, bytes, int] | threading.Event | Callable[[], None] | None
        ] = queue.SimpleQueue()
        self._threads: list[threading.Thread] = []
        self._reserve()
        if threaded:
            self._start(self._write_loop, "record-writer")
            if durable:
                self._start(self._sync_loop, "record-sync")

    def _start(self, target: Any, name: str) -> None:
        thread = threading.Thread(target=target, name=name, daemon=True)
        self._threads.append(thread)
        thread.start()

    # -- the caller's side ---------------------------------------------------

    def put(self, file: str, data: bytes, *, vital: bool = False, end: bool = False) -> None:
        """Append ``data`` to ``file`` (made on first use).

        Args:
            vital: sync at once, and try even after a failure.
            end: nothing more will come for this file.

        Raises:
            RecordError: the disk has failed before, or cannot keep up.
        """
        if self.failed is not None and not vital:
            raise self.failed
        flags = vital | end << 1
        if not self._threads:
            self._append(file, data, flags)
            if self.failed is not None and not vital:
                raise self.failed
            if self.durable and (vital or time.monotonic() - self._synced_s > SYNC_PERIOD_S):
                self._sync()
            return
        self._queued += len(data)
        if self._queued - self._written > QUEUE_BYTES and not vital:
            self._fail(
                RecordError(
                    str(self.root),
                    f"the disk is {QUEUE_BYTES >> 20} MB behind the data that come in",
                    "use a faster disk, or fewer or smaller camera frames",
                )
            )
            assert self.failed is not None
            raise self.failed
        self._jobs.put((file, data, flags))

    def then(self, work: Callable[[], None]) -> None:
        """Do ``work`` once all that was put before is with the operating system; not if it failed.

        It is done by the writer's thread and must not raise.
        """
        if self._threads:
            self._jobs.put(work)
        elif self.failed is None:
            work()

    def drain(self, timeout_s: float = JOIN_S) -> bool:
        """Wait until all that was put has gone to the operating system."""
        if not self._threads:
            return True
        reached = threading.Event()
        self._jobs.put(reached)
        return reached.wait(timeout_s)

    def close(self) -> dict[str, dict[str, Any]]:
        """Write, sync and close everything; size and CRC of each file, in order of name.

        A slow disk is waited for as long as it gets on with what is queued.

        Raises:
            RecordError: the disk does not answer any more.
        """
        self._stop = True
        if self._threads:
            self._jobs.put(None)
            self._sync_wanted.set()
            for thread in self._threads:
                done = -1
                while thread.is_alive() and done != self._written:  # slow is not dead
                    done = self._written
                    thread.join(JOIN_S)
                if thread.is_alive():
                    raise RecordError(
                        str(self.root),
                        f"the disk has not answered for {JOIN_S:.0f} s",
                        "check the disk; what it holds already is readable",
                    )
        self._pay()
        self.discarded_bytes += sum(len(data) for _, data in self._owed)
        self._dirty.update(self._files.values())
        self._ended.update(self._files.values())
        self._sync()
        self.release_reserve()
        return {
            name: {"size": file.size, "crc32": f"{file.crc:08x}"}
            for name, file in sorted(self._files.items())
        }

    def release_reserve(self) -> None:
        """Give back the space kept for the last words."""
        with contextlib.suppress(OSError):
            os.unlink(self.root / RESERVE_NAME)

    # -- the writer's and the syncer's side ----------------------------------

    def _reserve(self) -> None:
        with open(self.root / RESERVE_NAME, "xb", buffering=0) as out:
            write_all(out.fileno(), bytes(RESERVE_BYTES))

    def _fail(self, error: RecordError) -> None:
        if self.failed is None:
            self.failed = error
            self.release_reserve()

    def _append(self, file: str, data: bytes, flags: int) -> None:
        if self.failed is not None:
            if flags & 1:
                self._owe(file, data)
                self._pay()
            else:
                self.discarded_bytes += len(data)
            return
        try:
            self._write(file, data, flags)
        except OSError as error:
            self._fail(disk_error(self.root / file, "cannot be written", error))
            self._append(file, data, flags)  # now that the reserve has been given back

    def _write(self, file: str, data: bytes, flags: int = 0) -> None:
        handle = self._open(file)
        handle.write(data)
        with self._sync_lock:
            self._dirty.add(handle)
            if flags & 2:
                self._ended.add(handle)

    def _owe(self, file: str, data: bytes) -> None:
        if sum(len(owed) for _, owed in self._owed) + len(data) > OWED_BYTES:
            self.discarded_bytes += len(data)
        else:
            self._owed.append((file, data))

    def _pay(self) -> None:
        """Write what was refused, in order, as far as the disk takes it now."""
        with contextlib.suppress(OSError):
            while self._owed:
                self._write(*self._owed[0])
                del self._owed[0]

    def _open(self, file: str) -> _File:
        handle = self._files.get(file)
        if handle is None:
            path = self.root / file
            folders = {path.parent}
            if not path.parent.exists():
                path.parent.mkdir(parents=True, exist_ok=True)  # the caller may be first
                folders.add(path.parent.parent)
            handle = self._files[file] = _File(path)
            with self._sync_lock:
                self._grown.update(folders)
        return handle

    def _write_loop(self) -> None:
        while (job := self._jobs.get()) is not None:
            if isinstance(job, threading.Event):
                job.set()
                continue
            if not isinstance(job, tuple):
                if self.failed is None:
                    job()
                continue
            file, data, flags = job
            try:
                self._append(file, data, flags)
            except Exception as error:  # a writer that dies in silence would lose all to come
                self._fail(RecordError(str(self.root / file), f"cannot be written: {error!r}"))
            self._written += len(data)
            if flags & 1:
                self._sync_wanted.set()

    def _sync_loop(self) -> None:
        while not self._stop:
            self._sync_wanted.wait(SYNC_PERIOD_S)
            self._sync_wanted.clear()
            self._sync()

    def _sync(self) -> None:
        """Push dirty files to the medium and close those that have ended."""
        with self._sync_lock:
            dirty, self._dirty = self._dirty, set()
            ended, self._ended = self._ended, set()
            grown, self._grown = self._grown, set()
        if self.durable or self._stop:
            for file in dirty:
                try:
                    if file.fd >= 0:
                        os.fsync(file.fd)
                except OSError as error:
                    self._fail(disk_error(file.path, "cannot be synced", error))
            for folder in grown:
                with contextlib.suppress(OSError):
                    sync_folder(folder)
        for file in ended:
            if file.fd >= 0:
                with contextlib.suppress(OSError):
                    os.close(file.fd)
                file.fd = -1
        self._synced_s = time.monotonic()
