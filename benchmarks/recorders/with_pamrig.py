"""pamrig's record: rows to the system as they come, a batch each 50, fsync each second."""

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
from daq.record import RecordWriter
from daq.run import open_run

COLUMNS = {"row": "int64", **dict.fromkeys(CHANNELS, "float64")}
BACKLOG = 500  # batches: the queue refuses more than 64 MB, so a flat-out feed must wait for it


def columns(first: int, block: np.ndarray) -> dict[str, np.ndarray]:
    return {
        "row": np.arange(first, first + len(block)),
        **{name: block[:, k] for k, name in enumerate(CHANNELS)},
    }


def record(job: dict[str, Any]) -> int:
    writer = RecordWriter(job["folder"], {"protocol": "bench"}, RealClock())
    writer.stream("bench", COLUMNS)
    count = 0
    if job["mode"] == "flat":
        for first, block in blocks(job):
            writer.append("bench", columns(first, block))
            count = first + BLOCK
            if count % (BACKLOG * BLOCK) == 0:
                writer.sync()
    else:
        frame = job["frame"]
        for number, _ in rows(job):
            count = number + 1
            if count % frame == 0:
                at = (count - frame) % len(TABLE)
                writer.ahead("bench", columns(count - frame, TABLE[at : at + frame]))
            if count % BLOCK == 0:
                at = (count - BLOCK) % len(TABLE)
                writer.append("bench", columns(count - BLOCK, TABLE[at : at + BLOCK]))
    writer.finalize("clean")
    return count


def read(job: dict[str, Any]) -> dict[str, int]:
    (manifest,) = Path(job["folder"]).glob("*/run.json")
    found = open_run(manifest.parent).samples("bench")
    if not found:
        return {"rows": 0, "wrong": 0}
    return checked(found["row"], np.column_stack([found[name] for name in CHANNELS]))


if __name__ == "__main__":
    serve(record, read, f"pamrig {importlib.metadata.version('pamrig')}")
