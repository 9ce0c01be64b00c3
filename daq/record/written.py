"""How far each file of a running record is written: what ``final.json`` says of a finished one.

``written.map`` holds, for each index and for the events, the number of bytes written and their
CRC-32. It is memory-mapped and updated after each write. So after a kill of the process it shows
whether a file was deleted, exchanged or cut off afterwards. The chunks of bulk files are checked
by their indexes. Files of constant size (write-ahead files, the reserve) have no CRC here.

The file has 64 kB, so that no page of it must be allocated on a full disk: a head of 512 bytes
(a sealed line, then zeros), then slots of 256 bytes. A slot is a name of up to 160 bytes and its
CRC-32, then twice (size, CRC-32 of the file, CRC-32 of name, size and CRC). The two copies are
written in turn, so that one is valid at any time.
"""

from __future__ import annotations

import contextlib
import mmap
import os
import struct
import threading
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from daq.errors import RecordError
from daq.record.chunks import Problem, unwritten
from daq.record.safe_read import read_inside, size_inside
from daq.record.sealed import open_line, seal_line, write_all

WRITTEN = "written.map"
HEAD_BYTES = 512
SLOT_BYTES = 256
SLOTS = 254
TOTAL_BYTES = HEAD_BYTES + SLOTS * SLOT_BYTES
LONGEST_NAME = 160
_GONE = 2**64 - 1
_CRC = struct.Struct("<I")
_COPY = struct.Struct("<QII")
_COPIES = (176, 192)
_CONSTANT = 2**32 - 1
"""In place of a CRC: only the size of this file is known. No file with that CRC is expected."""


@dataclass(frozen=True)
class Written:
    """What is known of a file.

    Attributes:
        size: number of bytes.
        crc32: of these bytes, as in ``final.json``; "" if only the size is known.
        exact: the file has no further bytes.
    """

    size: int
    crc32: str
    exact: bool


class WrittenMap:
    """The map of a running record; see the module.

    Args:
        root: the run folder.
        head: members of the first line.

    Raises:
        OSError: the file cannot be created.
    """

    def __init__(self, root: Path, head: dict[str, Any]) -> None:
        self._path = root / WRITTEN
        self._lock = threading.Lock()
        self._slots: dict[str, int] = {}
        self._turn: dict[str, int] = {}
        line = seal_line(head)
        if len(line) > HEAD_BYTES:
            raise ValueError(f"the head of {WRITTEN} has {len(line)} bytes, allowed {HEAD_BYTES}")
        flags = os.O_RDWR | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0)
        fd = os.open(self._path, flags, 0o644)
        try:
            write_all(fd, line.ljust(TOTAL_BYTES, b"\0"))
            self._map: mmap.mmap | None = mmap.mmap(fd, TOTAL_BYTES)
        finally:
            os.close(fd)

    def put(self, name: str, size: int, crc: int) -> None:
        """State that ``size`` bytes with this CRC are written to a file."""
        with self._lock:
            if self._map is None:
                return
            at = self._slots.get(name)
            new = at is None
            if at is None:
                if len(self._slots) == SLOTS or len(name.encode()) > LONGEST_NAME:
                    return  # the file is then unknown to the map: verify reports it as unlisted
                at = self._slots[name] = HEAD_BYTES + SLOT_BYTES * len(self._slots)
                self._turn[name] = 0
            turn = self._turn[name]
            self._turn[name] = 1 - turn
            begin = at + _COPIES[turn]
            key = name.encode()
            self._map[begin : begin + _COPY.size] = _COPY.pack(size, crc, _check(key, size, crc))
            if new:  # the name makes the slot valid
                block = key.ljust(LONGEST_NAME, b"\0") + _CRC.pack(zlib.crc32(key))
                self._map[at : at + len(block)] = block

    def constant(self, name: str, size: int) -> None:
        """State that a file with changing content always has this size."""
        self.put(name, size, _CONSTANT)

    def gone(self, name: str) -> None:
        """State that a file will be deleted."""
        if name in self._slots:
            self.put(name, _GONE, 0)

    def close(self, finished: bool) -> None:
        """Unmap the file; delete it if the run is finished."""
        with self._lock:
            if self._map is not None:
                self._map.close()
                self._map = None
        if finished:
            with contextlib.suppress(OSError):
                os.unlink(self._path)


class WrittenFiles:
    """The map of an interrupted record as found.

    Attributes:
        there: the file exists.
        head: members of its first line; empty if damaged.
        files: what is known of each file that the record had.
        problems: damage of the map itself.
    """

    def __init__(self, root: Path) -> None:
        self.there = os.path.lexists(root / WRITTEN)
        self.head: dict[str, Any] = {}
        self.files: dict[str, Written] = {}
        self.problems: list[Problem] = []
        if self.there:
            try:
                if (size := size_inside(root, WRITTEN)) != TOTAL_BYTES:
                    what = f"{size} bytes, expected {TOTAL_BYTES}"
                    self.problems.append(Problem(WRITTEN, min(size, TOTAL_BYTES), what))
                self._read(read_inside(root, WRITTEN, 4 * TOTAL_BYTES))
            except RecordError as error:
                self.problems.append(Problem(WRITTEN, 0, error.what))

    def _read(self, data: bytes) -> None:
        end = data.find(b"\n") + 1
        try:
            self.head = open_line(data[:end])
        except ValueError:
            self.problems.append(Problem(WRITTEN, 0, "its first line does not match its CRC"))
        self.problems += unwritten(WRITTEN, data, end, HEAD_BYTES)
        for at in range(HEAD_BYTES, min(len(data), TOTAL_BYTES), SLOT_BYTES):
            slot = data[at : at + SLOT_BYTES].ljust(SLOT_BYTES, b"\0")
            if not slot.strip(b"\0"):
                # Slots are taken one after the other: all that follow are unused.
                self.problems += unwritten(WRITTEN, data, at, TOTAL_BYTES)
                break
            key = slot[:LONGEST_NAME].rstrip(b"\0")
            copies = [_COPY.unpack_from(slot, c) for c in _COPIES]
            valid = [copy[:2] for copy in copies if copy[2] == _check(key, *copy[:2])]
            named = slot[LONGEST_NAME : LONGEST_NAME + _CRC.size] == _CRC.pack(zlib.crc32(key))
            if not named or not valid:
                self.problems.append(Problem(WRITTEN, at, "a damaged entry", SLOT_BYTES, not key))
                continue
            self.problems += unwritten(
                WRITTEN, data, at + LONGEST_NAME + _CRC.size, at + _COPIES[0]
            )
            self.problems += unwritten(WRITTEN, data, at + _COPIES[1] + _COPY.size, at + SLOT_BYTES)
            for copy, begin in zip(copies, _COPIES, strict=True):
                if any(copy) and copy[:2] not in valid:
                    # A kill in the middle of a write leaves this too; the other copy holds.
                    what = "one of the two copies of an entry is damaged"
                    self.problems.append(Problem(WRITTEN, at + begin, what, _COPY.size, True))
            size, crc = max(valid)
            name = key.decode("utf-8", "replace")
            if size != _GONE and crc == _CONSTANT:
                self.files[name] = Written(size, "", True)
            elif size != _GONE:
                self.files[name] = Written(size, f"{crc:08x}", False)


def _check(key: bytes, size: int, crc: int) -> int:
    return zlib.crc32(struct.pack("<QI", size, crc), zlib.crc32(key)) or 1
