"""A small record with everything in it, for the tests of the record."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from daq.calibration import Calibration
from daq.clock import VirtualClock
from daq.link.telemetry import VALVE_COLUMNS, VALVE_UNITS
from daq.record.segments import Columns
from daq.record.writer import RecordWriter
from daq.store.run import Run

PRESSURE = Calibration("pressure_kpa", "kPa", "counts", -100.0, 0.25, 0.5, 0.002, (0.0, 700.0))
FORCE = Calibration("force_n", "N", "g", 0.0, -9.81 / 1000)
BALANCE_COLUMNS = {"row": "int64", "host_ns": "int64", "grams": "float64", "stable": "uint8"}
MANIFEST: dict[str, Any] = {
    "protocol": "isometric",
    "specimen": "muscle 7",
    "operator": "someone",
    "parameters": {"lengths_mm": [50.0, 52.5], "repeats": 2},
    "calibrations": [PRESSURE.to_dict(), FORCE.to_dict()],
}


def valve_batch(first: int, rows: int = 50) -> Columns:
    """Rows that tell their own number in every column."""
    seq = np.arange(first, first + rows)
    return {
        "seq": seq,
        "device_us": 5_000_000 + seq * 1000,
        "host_ns": seq * 1_000_000 + 300_000,
        "boot": np.full(rows, 7, np.uint16),
        "counts": (400 + seq % 3000).astype(np.uint16),
        "flags": (seq % 251).astype(np.uint8),
        "inlet_u5": (seq % 201).astype(np.uint8),
        "vent_u5": (seq % 13).astype(np.uint8),
        "setpoint_x16": (6400 + seq % 1000).astype(np.uint16),
    }


def balance_batch(row: int) -> Columns:
    return {
        "row": np.array([row]),
        "host_ns": np.array([row * 100_000_000]),
        "grams": np.array([-100.25 - row]),
        "stable": np.array([row % 2], np.uint8),
    }


def jpeg(number: int) -> bytes:
    return bytes(np.random.default_rng(number).integers(0, 256, 300, dtype=np.uint8))


def begin(root: Path, **options: Any) -> tuple[RecordWriter, VirtualClock]:
    clock = VirtualClock(9_000_000_000)
    settings = {"durable": False, "threaded": False, "segment_rows": 200, **options}
    writer = RecordWriter(root, MANIFEST, clock, **settings)
    writer.stream("valve", VALVE_COLUMNS, VALVE_UNITS)
    writer.stream("balance", BALANCE_COLUMNS, {"grams": "g"})
    return writer, clock


def fill(writer: RecordWriter, clock: VirtualClock, batches: int = 12) -> None:
    """``batches`` x 50 ms of a run: samples, a frame, bytes of the wire, an event each."""
    for k in range(batches):
        writer.append("valve", valve_batch(50 * k))
        writer.append("balance", balance_batch(k))
        writer.frame(jpeg(k), clock.now_ns(), exposure_us=1000 + k)
        writer.wire("balance", clock.now_ns(), b"S S %d g\r\n" % k)
        writer.event("state", state="point", pressure_kpa=20.0 * k, text="µ\n")
        clock.sleep(0.05)


def content(run: Run) -> dict[str, Any]:
    """Everything that the run gives out as good data, as plain values."""
    from daq.errors import RecordError

    found: dict[str, Any] = {"events": run.events, "final": run.final, "frames": {}, "wire": []}
    try:
        found["manifest"] = run.manifest
    except RecordError:
        found["manifest"] = None
    for meta in run.frames:
        try:
            found["frames"][meta["frame"]] = (meta, run.frame_bytes(meta["frame"]))
        except RecordError:
            continue
    for stream in ("valve", "balance"):
        try:
            columns = run.samples(stream)
        except RecordError:
            columns = {}
        found[stream] = list(zip(*(c.tolist() for c in columns.values()), strict=True))
    try:
        found["wire"] = run.wire("balance")
    except RecordError:
        found["wire"] = []
    return found
