"""Rows that wait for their batch, already safe from a kill.

A batch is 50 ms long, because an Arrow message of one row would be a dozen times its data. What
has come since the last batch stands meanwhile in ``samples/STREAM.ahead``: one short entry for
each handful of rows, put into pages that the process shares with the operating system, so that
they outlive it without a call that a busy disk could hold up. In a finished run there is no such
file.

The file is eight slots of 8 kB. Entries of one batch stand one after the other in one slot, and
zeros after them; once the batch is with the operating system, its slot is zeros again. An entry is
``PAhd``, the CRC-32 of all that follows in it, the number of its first row, how many rows it has,
and the columns one after the other as the stream declares them, little-endian.
"""

from __future__ import annotations

import contextlib
import mmap
import os
import struct
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from daq.record.chunks import Problem
from daq.record.sealed import write_all
from daq.record.segments import Columns, StreamSchema
from daq.record.within import LARGEST_BULK, read_inside

MAGIC = b"PAhd"
SLOTS = 8
SLOT_BYTES = 8192
_HEAD = struct.Struct("<4sI")
ROWS = "<qI"
_ROWS = struct.Struct(ROWS)
_START = _HEAD.size + _ROWS.size


def ahead_name(stream: str) -> str:
    """The file within the run folder."""
    return f"samples/{stream}.ahead"


def ahead_entry(parts: Sequence[bytes], first_row: int, rows: int) -> bytes:
    """One entry; ``parts`` are the columns' bytes in the schema's order and dtypes."""
    return sealed_entry(b"".join([_ROWS.pack(first_row, rows), *parts]))


def sealed_entry(body: bytes) -> bytes:
    """One entry; ``body`` is the number of its first row, how many they are, and the columns."""
    return _HEAD.pack(MAGIC, zlib.crc32(body)) + body


def entries_a_slot(row_bytes: int) -> int:
    """How many entries of one row a slot has room for."""
    return SLOT_BYTES // (_START + row_bytes)


class AheadFile:
    """The file of one stream while its run goes on.

    The caller puts entries and turns to the next slot; whoever writes batches clears. Where the
    disk is so far behind that no slot is free, entries are left out: their batch still comes.

    Raises:
        OSError: the file cannot be made.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        path.parent.mkdir(exist_ok=True)
        fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o644)
        try:
            write_all(fd, bytes(SLOTS * SLOT_BYTES))
            self._map = mmap.mmap(fd, SLOTS * SLOT_BYTES)
        finally:
            os.close(fd)
        self._used = [0] * SLOTS
        self._slot = 0
        self._full = False

    def put(self, entry: bytes) -> None:
        """One entry more of the batch to come."""
        at = self._used[self._slot]
        if self._full or at + len(entry) > SLOT_BYTES:
            self._full = True  # rows after a gap would be of no use
            return
        begin = self._slot * SLOT_BYTES + at
        self._map[begin : begin + len(entry)] = entry
        self._used[self._slot] = at + len(entry)

    def turn(self) -> int:
        """The batch is on its way: go on in the next slot; the one to clear when it is there."""
        done = self._slot
        self._slot = (done + 1) % SLOTS
        self._full = self._used[self._slot] > 0
        return done

    def clear(self, slot: int) -> None:
        """Zeros again."""
        begin, used = slot * SLOT_BYTES, self._used[slot]
        self._map[begin : begin + used] = bytes(used)
        self._used[slot] = 0

    def close(self, finished: bool) -> None:
        """Let go of it; a finished run needs it no more."""
        self._map.close()
        if finished:
            with contextlib.suppress(OSError):
                os.unlink(self._path)


class AheadRows:
    """What a killed run left ahead of its last batch.

    Args:
        folder: the run folder; None where there can be no such rows.
        schema: of the stream.
        rows: how many rows the batches hold; entries below are superseded and left out.

    Attributes:
        columns: sound rows that no batch holds, in order; empty arrays if there are none.
        missing: row ranges (half open) between the batches and these rows, and among them.
        problems: bytes that are not as they were written.
    """

    def __init__(self, folder: Path | None, schema: StreamSchema, rows: int) -> None:
        self.name = ahead_name(schema.name)
        self.problems: list[Problem] = []
        self.missing: list[tuple[int, int]] = []
        self._dtypes = {n: np.dtype(d).newbyteorder("<") for n, d in schema.columns.items()}
        self._row_bytes = sum(d.itemsize for d in self._dtypes.values())
        there = folder is not None and (folder / self.name).is_file()
        data = read_inside(folder, self.name, LARGEST_BULK) if folder and there else b""
        found = [e for at in range(0, len(data), SLOT_BYTES) for e in self._sound(data, at)]
        parts: list[Columns] = []
        for first, count, at in sorted(found):
            if first < rows:
                continue
            if first > rows:
                self.missing.append((rows, first))
            parts.append(self._columns(data, at, count))
            rows = first + count
        self.columns: Columns = {
            name: np.concatenate([np.empty(0, dtype), *(p[name] for p in parts)])
            for name, dtype in self._dtypes.items()
        }

    def __len__(self) -> int:
        """How many rows there are."""
        return len(next(iter(self.columns.values())))

    def _sound(self, data: bytes, at: int) -> Iterator[tuple[int, int, int]]:
        """(first row, rows, where its columns begin) of each sound entry of a slot."""
        limit = min(at + SLOT_BYTES, len(data))
        while at + _START <= limit:
            first, rows = _ROWS.unpack_from(data, at + _HEAD.size)
            end = at + _START + rows * self._row_bytes
            seal = _HEAD.pack(MAGIC, zlib.crc32(data[at + _HEAD.size : min(end, limit)]))
            if end > limit or data[at : at + _HEAD.size] != seal:
                break
            yield first, rows, at + _START
            at = end
        rest = data[at:limit].rstrip(b"\x00")
        if rest:
            what = "bytes that are no sound entry, nothing read from here on in this slot"
            torn = rest.startswith(MAGIC) and MAGIC not in rest[1:]
            self.problems.append(Problem(self.name, at, what, len(rest), torn))

    def _columns(self, data: bytes, at: int, count: int) -> Columns:
        out: Columns = {}
        for name, dtype in self._dtypes.items():
            out[name] = np.frombuffer(data, dtype, count, at)
            at += dtype.itemsize * count
        return out
