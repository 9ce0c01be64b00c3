"""A stream recorded row by row. A row survives a kill once the call returns.

An Arrow message per row would have twelve times the size of its data. The writer therefore
collects rows into batches of up to 50 ms or 8 kB. The write-ahead file (:mod:`daq.record.ahead`)
holds a row until its batch is written.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np

from daq.clock import Clock
from daq.record.ahead import ROWS, entries_per_slot, sealed_entry
from daq.record.segments import StreamSchema
from daq.record.writer import RecordWriter

BATCH_NS = 50_000_000
_CODES = {"i1": "b", "i2": "h", "i4": "i", "i8": "q", "u1": "B", "u2": "H", "u4": "I", "u8": "Q",
          "f2": "e", "f4": "f", "f8": "d"}  # fmt: skip


class RowWriter:
    """Rows of one stream in order of arrival.

    A batch ends with the row that fills it, with the first row 50 ms after its first, or at once if
    a row arrives alone. Call :meth:`flush` before the run ends, and after a burst of rows that ends
    long before the run.

    Args:
        record: the run record; no other code may write to this stream.
        clock: determines when a batch is due.
        name, schema, units: as for :meth:`RecordWriter.stream`, which this calls.

    Attributes:
        rows: number of rows added.
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
        self._most = max(1, entries_per_slot(StreamSchema(name, schema).row_bytes))
        self._waiting: list[bytes] = []
        self._until_ns = self._last_ns = -BATCH_NS

    def add(self, values: Sequence[float]) -> int:
        """Add a row, one value per column in the schema's order; returns its number, from 0.

        Raises:
            RecordError: the disk has failed.
            ValueError: the number of values is wrong, or a value does not fit its column.
        """
        try:
            body = self._pack(self.rows, 1, *values)
        except struct.error as error:
            raise ValueError(
                f"stream {self._name}: {values!r} is not a row of it: {error}"
            ) from None
        now_ns = self._clock.now_ns()
        waiting = self._waiting
        if not waiting:
            self._until_ns = now_ns + BATCH_NS
        self._record.write_ahead_row(self._name, sealed_entry(body))
        waiting.append(body)
        self.rows += 1
        alone = now_ns - self._last_ns > BATCH_NS
        if alone or len(waiting) >= self._most or now_ns >= self._until_ns:
            self.flush()
        self._last_ns = now_ns
        return self.rows - 1

    def flush(self) -> None:
        """Write the waiting rows as a batch.

        Raises:
            RecordError: the disk has failed.
        """
        if self._waiting:
            rows = np.frombuffer(b"".join(self._waiting), self._layout)
            self._waiting.clear()
            self._record.append(self._name, {n: rows[n] for n in self._names})
