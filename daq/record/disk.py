"""Append-only files, written at once and synced in the background.

Three roles, so that a slow one does not delay a faster one. The caller encodes and queues data.
The *writer* thread passes the data to the operating system; they then survive a kill of this
process. The *syncer* thread syncs the files to the medium once a second, or at once on request;
the data then survive a power cut. Without threads the caller does all of this.
"""

from __future__ import annotations

import contextlib
import errno
import os
import queue
import shutil
import threading
import time
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from daq.errors import RecordError
from daq.record.sealed import sync_folder, write_all
from daq.record.written import WrittenMap

RESERVE_NAME = "reserve.zero"
RESERVE_BYTES = 65536
SYNC_PERIOD_S = 1.0
QUEUE_BYTES = 64 << 20
JOIN_S = 30.0
TELL_S = 3.0
"""How often a wait for the disk at the end of a run is told of."""
DEFERRED_BYTES = 1 << 20
"""Limit of the vital data kept in memory after a failure, to be written later."""

_REMEDIES = {
    errno.ENOSPC: "free some disk space or choose another runs folder; earlier data are readable",
    errno.EFBIG: "the system limits the size of a file (ulimit -f); lift it or use another disk",
    errno.EROFS: "the file system is read-only; choose another runs folder",
    errno.EACCES: "choose a runs folder that you may write to",
    errno.EIO: "the disk reports a fault; copy the record away and replace the disk",
}
_REMEDIES[getattr(errno, "EDQUOT", errno.ENOSPC)] = _REMEDIES[errno.ENOSPC]


def disk_error(where: Path | str, doing: str, error: OSError) -> RecordError:
    """Convert an OSError while writing into an error with a remedy."""
    remedy = _REMEDIES.get(error.errno or 0, "check the disk and the permissions of this folder")
    return RecordError(str(where), f"{doing}: {error.strerror or error}", remedy)


class _File:
    """An append-only file with the CRC of its content; ``listed`` in the map of files."""

    def __init__(self, path: Path) -> None:
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND | getattr(os, "O_BINARY", 0)
        self.path = path
        self.listed = path.suffix == ".jsonl"
        self.fd = os.open(path, flags, 0o644)
        self.size = 0
        self.crc = 0

    def write(self, data: bytes) -> None:
        try:
            write_all(self.fd, data)
        except OSError:
            with contextlib.suppress(OSError):
                os.truncate(self.path, self.size)  # no torn chunk; space for final.json
            raise
        self.size += len(data)
        self.crc = zlib.crc32(data, self.crc)


class Disk:
    """All files of one run folder during the run.

    Args:
        root: the run folder, which exists.
        head: members of the first line of its map of files (:mod:`daq.record.written`).
        durable: sync once a second, and at once on request; else only at close.
        threaded: write and sync in threads.

    Attributes:
        failed: the first error, else None. After an error the disk rejects bulk data. It still
            tries to write lines marked ``vital``, in their order.
        discarded_bytes: number of queued bytes that could not be written.
    """

    def __init__(self, root: Path, head: dict[str, Any], durable: bool, threaded: bool) -> None:
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
        self._deferred: list[tuple[str, bytes]] = []
        self._queued = 0
        self._written = 0
        self._synced_s = time.monotonic()
        self._jobs: queue.SimpleQueue[
            tuple[str, bytes, int] | threading.Event | Callable[[], None] | None
        ] = queue.SimpleQueue()
        self._threads: list[threading.Thread] = []
        with open(root / RESERVE_NAME, "xb", buffering=0) as out:
            write_all(out.fileno(), bytes(RESERVE_BYTES))
        self.written = WrittenMap(root, head)
        self.written.constant(RESERVE_NAME, RESERVE_BYTES)
        if threaded:
            self._start(self._write_loop, "record-writer")
            if durable:
                self._start(self._sync_loop, "record-sync")

    def _start(self, target: Callable[[], None], name: str) -> None:
        thread = threading.Thread(target=target, name=name, daemon=True)
        self._threads.append(thread)
        thread.start()

    # -- called by the user of the record --------------------------------------

    def put(self, file: str, data: bytes, *, vital: bool = False, end: bool = False) -> None:
        """Append ``data`` to ``file``, which is created on first use.

        Args:
            vital: sync at once, and try to write even after a failure.
            end: this is the last data for the file.

        Raises:
            RecordError: the disk has failed before, or is too slow.
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
            what = f"the disk is {QUEUE_BYTES >> 20} MB behind the data that come in"
            remedy = "use a faster disk, or fewer or smaller camera frames"
            self._fail(RecordError(str(self.root), what, remedy))
            assert self.failed is not None
            raise self.failed
        self._jobs.put((file, data, flags))

    def call_after_writes(self, work: Callable[[], None]) -> None:
        """Call ``work`` once all earlier data are with the operating system; not after a failure.

        The writer thread calls it; it must not raise.
        """
        if self._threads:
            self._jobs.put(work)
        elif self.failed is None:
            work()

    def drain(self, timeout_s: float = JOIN_S) -> bool:
        """Wait until all queued data are with the operating system; False on time-out."""
        if not self._threads:
            return True
        reached = threading.Event()
        self._jobs.put(reached)
        return reached.wait(timeout_s)

    def settle(self) -> None:
        """Write and sync all queued data now.

        Raises:
            RecordError: they cannot be written.
        """
        if not self.drain():
            raise RecordError(
                str(self.root), f"the disk has not responded for {JOIN_S:.0f} s", "check the disk"
            )
        self._sync()
        if self.failed is not None:
            raise self.failed

    def close(self, tell: Callable[[str], None] = lambda text: None) -> dict[str, dict[str, Any]]:
        """Write, sync and close all files; returns size and CRC of each file, sorted by name.

        Waits for a slow disk as long as it makes progress, and calls ``tell`` with how much is
        left, every ``TELL_S`` seconds.

        Raises:
            RecordError: the disk does not respond any more.
        """
        self._stop = True
        if self._threads:
            self._jobs.put(None)
            self._sync_wanted.set()
            for thread in self._threads:
                self._join(thread, tell)
        self._write_deferred()
        self.discarded_bytes += sum(len(data) for _, data in self._deferred)
        self._dirty.update(self._files.values())
        self._ended.update(self._files.values())
        self._sync()
        self.release_reserve()
        return {
            name: {"size": file.size, "crc32": f"{file.crc:08x}"}
            for name, file in sorted(self._files.items())
        }

    def _join(self, thread: threading.Thread, tell: Callable[[str], None]) -> None:
        done, since_s = self._written, time.monotonic()
        thread.join(TELL_S)
        while thread.is_alive():
            now_s = time.monotonic()
            if done != self._written:  # progress since the last check
                done, since_s = self._written, now_s
            elif now_s - since_s > JOIN_S:
                raise RecordError(
                    str(self.root),
                    f"the disk has not responded for {JOIN_S:.0f} s",
                    "check the disk; the data on it are readable",
                )
            left_kb = (self._queued - self._written) / 1e3
            tell(f"the disk is slow: {left_kb:.0f} kB of the record are still to be written")
            thread.join(TELL_S)

    def release_reserve(self) -> None:
        """Free the space reserved for the final messages."""
        self.written.gone(RESERVE_NAME)
        with contextlib.suppress(OSError):
            os.unlink(self.root / RESERVE_NAME)

    # -- called by the writer and syncer threads --------------------------------

    def _fail(self, error: RecordError) -> None:
        if self.failed is None:
            self.failed = error
            self.release_reserve()

    def _append(self, file: str, data: bytes, flags: int) -> None:
        if self.failed is not None:
            if flags & 1:
                self._defer(file, data)
                self._write_deferred()
            else:
                self.discarded_bytes += len(data)
            return
        try:
            self._write(file, data, flags)
        except OSError as error:
            self._fail(disk_error(self.root / file, "cannot be written", error))
            self._append(file, data, flags)  # again, after release of the reserve

    def _write(self, file: str, data: bytes, flags: int = 0) -> None:
        handle = self._open(file)
        handle.write(data)
        if handle.listed:
            self.written.put(file, handle.size, handle.crc)
        with self._sync_lock:
            self._dirty.add(handle)
            if flags & 2:
                self._ended.add(handle)

    def _defer(self, file: str, data: bytes) -> None:
        if sum(len(item) for _, item in self._deferred) + len(data) > DEFERRED_BYTES:
            self.discarded_bytes += len(data)
        else:
            self._deferred.append((file, data))

    def _write_deferred(self) -> None:
        """Write the deferred data in order, until the disk rejects one."""
        with contextlib.suppress(OSError):
            while self._deferred:
                self._write(*self._deferred[0])
                del self._deferred[0]

    def _open(self, file: str) -> _File:
        handle = self._files.get(file)
        if handle is None:
            path = self.root / file
            folders = {path.parent}
            if not path.parent.exists():
                path.parent.mkdir(parents=True, exist_ok=True)  # the caller may have made it
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
            except Exception as error:  # if the thread ended, all later data would be lost
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
        """Sync changed files to the medium and close those that have ended."""
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


BYTES_PER_POINT = 400_000
"""Upper estimate of the record size per settled point: some seconds at 1 kHz and one frame."""


def check_disk(root: Path, points: int) -> None:
    """Refuse to start a run that needs more space than the disk has.

    Raises:
        RecordError: names the required and the free space.
    """
    try:
        root.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RecordError(
            str(root), f"cannot hold runs: {error.strerror}", "choose another folder with --out"
        ) from None
    free = shutil.disk_usage(root).free
    need = 20_000_000 + points * BYTES_PER_POINT
    if free < need:
        raise RecordError(
            str(root),
            f"{free / 1e6:.0f} MB free, this run may need {need / 1e6:.0f} MB",
            "make room or choose another folder with --out",
        )
