"""Rows that wait for their batch, already safe from a kill.

A batch is 50 ms long, because an Arrow message of one row would be a dozen times its data. What
has come since the last batch stands meanwhile in ``samples/STREAM.ahead``: one short entry for
each handful of rows, handed to the operating system as they come. The batch that holds them
supersedes them, and the file is cut to nothing. In a finished run there is no such file.

An entry is ``PAhd``, the CRC-32 of all that follows in it, the number of its first row, how many
rows it has, and the columns one after the other as the stream declares them, little-endian.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from daq.chunks import Problem
from daq.segments import Columns, StreamSchema

MAGIC = b"PAhd"
_HEAD = struct.Struct("<4sI")
_ROWS = struct.Struct("<qI")


def ahead_name(stream: str) -> str:
    """The file within the run folder."""
    return f"samples/{stream}.ahead"


def ahead_entry(columns: Columns, first_row: int) -> bytes:
    """One entry; ``columns`` in the schema's order and dtypes, all of one length."""
    rows = len(next(iter(columns.values())))
    body = _ROWS.pack(first_row, rows) + b"".join([a.tobytes() for a in columns.values()])
    return _HEAD.pack(MAGIC, zlib.crc32(body)) + body


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
        self._dtypes = {n: np.dtype(d).newbyteorder("<") for n, d in schema.columns.items()}
        self._row_bytes = sum(d.itemsize for d in self._dtypes.values())
        self.missing: list[tuple[int, int]] = []
        path = folder / self.name if folder is not None else None
        data = path.read_bytes() if path is not None and path.is_file() else b""
        parts = list(self._sound(data, rows))
        self.columns: Columns = {
            name: np.concatenate([np.empty(0, dtype), *(p[name] for p in parts)])
            for name, dtype in self._dtypes.items()
        }

    def __len__(self) -> int:
        """How many rows there are."""
        return len(next(iter(self.columns.values())))

    def _sound(self, data: bytes, expected: int) -> Iterator[Columns]:
        """Entries from the front until one does not match its CRC; nothing is read after it."""
        at, start = 0, _HEAD.size + _ROWS.size
        while at < len(data):
            first, rows = 0, 0
            if at + start <= len(data):
                first, rows = _ROWS.unpack_from(data, at + _HEAD.size)
            end = at + start + rows * self._row_bytes
            seal = _HEAD.pack(MAGIC, zlib.crc32(data[at + _HEAD.size : end]))
            if end > len(data) or data[at : at + _HEAD.size] != seal:
                what = "entry does not match its CRC, nothing read from here on"
                torn = end > len(data) and data.startswith(MAGIC[: len(data) - at], at)
                self.problems.append(Problem(self.name, at, what, len(data) - at, torn))
                return
            if first >= expected:
                if first > expected:
                    self.missing.append((expected, first))
                yield self._columns(data, at + start, rows)
                expected = first + rows
            at = end

    def _columns(self, data: bytes, at: int, count: int) -> Columns:
        out: Columns = {}
        for name, dtype in self._dtypes.items():
            out[name] = np.frombuffer(data, dtype, count, at)
            at += dtype.itemsize * count
        return out
