"""Write-ahead file: rows that survive a kill of the process before their batch is written.

A batch covers 50 ms, because an Arrow message of one row would have twelve times the size of its
data. Until the batch is written, ``samples/STREAM.ahead`` holds its rows, in short entries of a
few rows each. The file is memory-mapped: the rows survive the process without a system call that
a busy disk could delay. A finished run does not contain this file.

The file begins with a sealed line that names run and stream, and zeros up to 512 bytes (records of
format 1 have no such line). Then it has eight slots of 8 kB. The entries of one batch follow one
another in one slot; zeros fill the rest. The writer clears the slot after the batch has gone to the
operating system. An entry consists of ``PAhd``, the CRC-32 of the following bytes of the entry, the
number of its first row, the number of rows, and the columns in the declared order, little-endian.
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

from daq.record.chunks import Problem, unwritten
from daq.record.safe_read import LARGEST_TEXT, read_inside
from daq.record.sealed import open_line, seal_line, write_all
from daq.record.segments import Columns, StreamSchema

MAGIC = b"PAhd"
SLOTS = 8
SLOT_BYTES = 8192
HEAD_BYTES = 512
AHEAD_BYTES = HEAD_BYTES + SLOTS * SLOT_BYTES
_HEAD = struct.Struct("<4sI")
ROWS = "<qI"
_ROWS = struct.Struct(ROWS)
_START = _HEAD.size + _ROWS.size


def ahead_name(stream: str) -> str:
    """Path of the file within the run folder."""
    return f"samples/{stream}.ahead"


def ahead_entry(parts: Sequence[bytes], first_row: int, rows: int) -> bytes:
    """One entry; ``parts`` are the bytes of the columns in the schema's order and dtypes."""
    return sealed_entry(b"".join([_ROWS.pack(first_row, rows), *parts]))


def sealed_entry(body: bytes) -> bytes:
    """One entry; ``body`` is the first row number, the number of rows, and the columns."""
    return _HEAD.pack(MAGIC, zlib.crc32(body)) + body


def entries_per_slot(row_bytes: int) -> int:
    """Number of one-row entries that fit into a slot."""
    return SLOT_BYTES // (_START + row_bytes)


class AheadFile:
    """The write-ahead file of one stream during the run.

    The caller puts entries and selects the next slot; the writer of the batches clears slots. If
    the disk is so slow that no slot is free, entries are omitted; the batch still records the rows.

    Raises:
        OSError: the file cannot be created.
    """

    def __init__(self, path: Path, run_id: str, stream: str) -> None:
        self._path = path
        head = seal_line({"run_id": run_id, "stream": stream, "ahead": SLOTS})
        if len(head) > HEAD_BYTES:
            raise ValueError(f"stream {stream[:40]}...: its name is too long")
        path.parent.mkdir(exist_ok=True)
        fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o644)
        try:
            write_all(fd, head.ljust(AHEAD_BYTES, b"\0"))
            self._map = mmap.mmap(fd, AHEAD_BYTES)
        finally:
            os.close(fd)
        self._used = [0] * SLOTS
        self._slot = 0
        self._full = False

    def put(self, entry: bytes) -> None:
        """Add an entry of the next batch."""
        at = self._used[self._slot]
        if self._full or at + len(entry) > SLOT_BYTES:
            self._full = True  # a reader stops at a gap, so later entries are of no use
            return
        begin = HEAD_BYTES + self._slot * SLOT_BYTES + at
        self._map[begin : begin + len(entry)] = entry
        self._used[self._slot] = at + len(entry)

    def next_slot(self) -> int:
        """Continue in the next slot after a batch was queued; returns the slot to clear later."""
        done = self._slot
        self._slot = (done + 1) % SLOTS
        self._full = self._used[self._slot] > 0
        return done

    def clear(self, slot: int) -> None:
        """Fill a slot with zeros."""
        begin, used = HEAD_BYTES + slot * SLOT_BYTES, self._used[slot]
        self._map[begin : begin + used] = bytes(used)
        self._used[slot] = 0

    def close(self, finished: bool) -> None:
        """Unmap the file; delete it if the run is finished."""
        self._map.close()
        if finished:
            with contextlib.suppress(OSError):
                os.unlink(self._path)


class AheadRows:
    """Rows that a killed run wrote after its last complete batch.

    Args:
        folder: the run folder; None if there can be no such rows.
        schema: of the stream.
        rows: number of rows in batches; earlier entries are ignored.
        run_id: of the run; "" for a record of format 1, whose file has no head.

    Attributes:
        columns: valid rows that no batch contains, in order; else empty arrays.
        missing: row ranges (half open) between the batches and these rows, and among them.
        problems: damaged bytes.
    """

    def __init__(self, folder: Path | None, schema: StreamSchema, rows: int, run_id: str) -> None:
        self.name = ahead_name(schema.name)
        self.problems: list[Problem] = []
        self.missing: list[tuple[int, int]] = []
        self._dtypes = {n: np.dtype(d).newbyteorder("<") for n, d in schema.columns.items()}
        self._row_bytes = sum(d.itemsize for d in self._dtypes.values())
        there = folder is not None and os.path.lexists(folder / self.name)
        data = read_inside(folder, self.name, LARGEST_TEXT) if folder and there else b""
        start = 0
        if run_id and data:
            start = HEAD_BYTES if self._own(data, run_id, schema.name) else len(data)
        found = [e for at in range(start, len(data), SLOT_BYTES) for e in self._entries(data, at)]
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
        """Number of rows."""
        return len(next(iter(self.columns.values()), ()))

    def _own(self, data: bytes, run_id: str, stream: str) -> bool:
        """Whether the file is this stream's and not that of another run or stream."""
        end = data.find(b"\n") + 1
        self.problems += unwritten(self.name, data, end, HEAD_BYTES)
        try:
            head = open_line(data[:end])
        except ValueError:
            what = "its first line does not match its CRC, not read"
            self.problems.append(Problem(self.name, 0, what, len(data)))
            return False
        if (head.get("run_id"), head.get("stream")) != (run_id, stream):
            what = f"belongs to stream {head.get('stream')} of run {head.get('run_id')}, not read"
            self.problems.append(Problem(self.name, 0, what, len(data)))
            return False
        return True

    def _entries(self, data: bytes, at: int) -> Iterator[tuple[int, int, int]]:
        """(first row, rows, position of the columns) of each valid entry of a slot."""
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
            what = "not a valid entry; the rest of this slot is not read"
            torn = rest.startswith(MAGIC) and MAGIC not in rest[1:]
            self.problems.append(Problem(self.name, at, what, len(rest), torn))

    def _columns(self, data: bytes, at: int, count: int) -> Columns:
        out: Columns = {}
        for name, dtype in self._dtypes.items():
            out[name] = np.frombuffer(data, dtype, count, at)
            at += dtype.itemsize * count
        return out
