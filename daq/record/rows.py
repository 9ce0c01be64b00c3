"""A stream that is given row by row: each row is safe from a kill when the call returns.

A message for each row would be a dozen times its data, and a reader would wait for them; so rows
are joined into batches of up to 50 ms or 8 kB. Until its batch is written a row stands in pages
that the process shares with the operating system, see :mod:`daq.record.ahead`.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np

from daq.clock import Clock
from daq.record.ahead import ROWS, entries_a_slot, sealed_entry
from daq.record.segments import StreamSchema
from daq.record.writer import RecordWriter

BATCH_NS = 50_000_000
_CODES = {"i1": "b", "i2": "h", "i4": "i", "i8": "q", "u1": "B", "u2": "H", "u4": "I", "u8": "Q",
          "f2": "e", "f4": "f", "f8": "d"}  # fmt: skip


class RowWriter:
    """Rows of one stream, in the order in which they come.

    A batch is closed by the row that fills it, by the first row 50 ms after its first, and at once
    by a row that comes alone. Call :meth:`flush` where a burst ends long before the run, so that
    its last rows reach the medium; ending the run does so too, if this is closed before it.

    Args:
        record: what it is written to, and nothing else writes to this stream.
        clock: says when a batch is due.
        name, schema: as for :meth:`RecordWriter.stream`, which this calls.
        units: likewise.

    Attributes:
        rows: how many were given.
    """

    def __init__(
        self,
        record: RecordWriter,
        clock: Clock,
        name: str,
        schema: dict[str, str],
        units: dict[str, str] | None = None,
    ) -> None:
        record.stream(name, schema, units)
        self.rows = 0
        self._record = record
        self._clock = clock
        self._name = name
        dtypes = {n: np.dtype(d).newbyteorder("<") for n, d in schema.items()}
        self._pack = struct.Struct(ROWS + "".join(_CODES[d.str[1:]] for d in dtypes.values())).pack
        self._layout = np.dtype([("", "<i8"), ("", "<u4"), *dtypes.items()])
        self._names = list(dtypes)
        self._most = max(1, entries_a_slot(StreamSchema(name, schema).row_bytes))
        self._waiting: list[bytes] = []
        self._until_ns = self._last_ns = -BATCH_NS

    def add(self, values: Sequence[float]) -> int:
        """One row, a value for each column in the schema's order; its number, counted from 0.

        Raises:
            RecordError: the disk has failed.
            ValueError: a value is missing, too many, or does not fit its column.
        """
        try:
            body = self._pack(self.rows, 1, *values)
        except struct.error as error:
            raise ValueError(f"stream {self._name}: {values!r} is no row of it: {error}") from None
        now_ns = self._clock.now_ns()
        waiting = self._waiting
        if not waiting:
            self._until_ns = now_ns + BATCH_NS
        self._record.ahead_row(self._name, sealed_entry(body))
        waiting.append(body)
        self.rows += 1
        alone = now_ns - self._last_ns > BATCH_NS
        if alone or len(waiting) >= self._most or now_ns >= self._until_ns:
            self.flush()
        self._last_ns = now_ns
        return self.rows - 1

    def flush(self) -> None:
        """Make a batch of what waits for one.

        Raises:
            RecordError: the disk has failed.
        """
        if self._waiting:
            rows = np.frombuffer(b"".join(self._waiting), self._layout)
            self._waiting.clear()
            self._record.append(self._name, {n: rows[n] for n in self._names})
