"""pamrig's record: row by row or in blocks, fsync each second."""

from __future__ import annotations

import importlib.metadata
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent.parent))

import numpy as np
import pyarrow  # noqa: F401  a run imports it before it begins
from source import BLOCK, CHANNELS, TABLE, blocks, checked, rows, serve

from daq.clock import RealClock
from daq.record.ahead import SLOTS
from daq.record.rows import RowWriter
from daq.record.writer import RecordWriter
from daq.store.run import open_run

COLUMNS = {"row": "int64", **dict.fromkeys(CHANNELS, "float64")}
BATCHES = SLOTS - 1
BACKLOG = 50  # batches, some 10 ms of a flat-out feed


def columns(first: int, block: np.ndarray) -> dict[str, np.ndarray]:
    return {
        "row": np.arange(first, first + len(block)),
        **{name: block[:, k] for k, name in enumerate(CHANNELS)},
    }


def record(job: dict[str, Any]) -> int:
    writer = RecordWriter(job["folder"], {"protocol": "bench"}, RealClock())
    count = (by_row if job["rows"] == 1 else by_block)(writer, job)
    writer.finalize("clean")
    return count


def by_row(writer: RecordWriter, job: dict[str, Any]) -> int:
    """Each is with the system when `add` returns, as long as so many batches are not behind."""
    stream = RowWriter(writer, RealClock(), "bench", COLUMNS)
    behind = BATCHES * BLOCK if job["mode"] == "flat" else 1 << 60
    for number, values in rows(job):
        stream.add((number, *values))
        if not stream.rows % behind:
            writer.sync()
    stream.flush()
    return stream.rows


def by_block(writer: RecordWriter, job: dict[str, Any]) -> int:
    """Blocks as batches; of fewer rows than a batch (frames of the controller) ahead of it."""
    writer.stream("bench", COLUMNS)
    count, size = 0, job["rows"]
    for first, block in blocks(job, size):
        count = first + size
        if size < BLOCK:
            writer.write_ahead("bench", columns(first, block))
        if not count % BLOCK:
            at = (count - BLOCK) % len(TABLE)
            writer.append("bench", columns(count - BLOCK, TABLE[at : at + BLOCK]))
        if job["mode"] == "flat" and not count % (BACKLOG * BLOCK):
            writer.sync()
    return count


def read(job: dict[str, Any]) -> dict[str, int]:
    (manifest,) = Path(job["folder"]).glob("*/run.json")
    found = open_run(manifest.parent).samples("bench")
    if not found:
        return {"rows": 0, "wrong": 0}
    return checked(found["row"], np.column_stack([found[name] for name in CHANNELS]))


if __name__ == "__main__":
    serve(record, read, f"pamrig {importlib.metadata.version('pamrig')}")
