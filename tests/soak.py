"""`python -m tests.soak`: a long run at 1 kHz on the virtual clock: is a sample lost, does it grow?

The real firmware sends through the real driver into a real record, with its balance beside it. Each
virtual minute the memory is read; the slope is fitted to the second half, and at the end the
sequence numbers are counted segment by segment, so that the check itself takes no memory.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pyarrow as pa

from daq.record import RecordWriter
from daq.telemetry import VALVE_COLUMNS, VALVE_UNITS
from rigs.config import load_rig
from rigs.rig import open_rig
from rigs.session import BALANCE_SCHEMA, BALANCE_UNITS

SETPOINTS_KPA = (150.0, 300.0, 450.0, 250.0)


def soak(hours: float, folder: Path, tell: bool = True) -> dict[str, Any]:
    """Run so long and judge; plain values."""
    process = psutil.Process()
    config = load_rig("virtual")
    memory: list[tuple[float, float]] = []
    cpu = time.process_time()
    with open_rig(config) as rig:
        board = rig.bench.board  # type: ignore[union-attr]
        board._truth_every = 0  # the bench's own log of the truth grows, and is not wanted here
        record = RecordWriter(
            folder, {"protocol": "soak"}, rig.clock, durable=False, threaded=False
        )
        record.stream("valve", VALVE_COLUMNS, VALVE_UNITS)
        record.stream("balance", BALANCE_SCHEMA, BALANCE_UNITS)
        rig.valve.on_batch.append(lambda batch: record.append("valve", batch))
        rig.balance.on_rows.append(lambda batch: record.append("balance", batch))
        rig.pump.add(lambda: rig.valve.progress(1.0))
        rig.pump.for_seconds(0.5)
        rig.valve.arm()
        rig.valve.request("scheme burst")
        counts = config.calibrations["pressure_kpa"].raw
        minutes = round(hours * 60)
        for minute in range(minutes):
            rig.valve.set_point(float(counts(SETPOINTS_KPA[minute % len(SETPOINTS_KPA)])))
            rig.pump.for_seconds(60.0)
            memory.append(((minute + 1) / 60.0, process.memory_info().rss / 1e6))
            if tell and minute % 60 == 59:
                print(f"{memory[-1][0]:.0f} h, {memory[-1][1]:.0f} MB, "
                      f"{time.process_time() - cpu:.0f} s of CPU", flush=True)  # fmt: skip
        faults = list(rig.valve.faults)
        rig.vent()
        rig.valve.telemetry.flush()
        missing = rig.valve.telemetry.missing
        record.finalize("clean")
    rows, first, gaps = count(record.folder)
    later = np.array(memory[len(memory) // 2 :])
    slope = float(np.polyfit(later[:, 0], later[:, 1], 1)[0]) if len(later) > 2 else 0.0
    return {
        "hours": hours,
        "rows": rows,
        "first_seq": first,
        "gaps_in_seq": gaps,
        "missing_told": missing,
        "faults": faults,
        "rss_mb": [round(memory[0][1], 1), round(max(m for _, m in memory), 1)],
        "rss_mb_per_hour": round(slope, 3),
        "cpu_s": round(time.process_time() - cpu, 1),
    }


def count(folder: Path) -> tuple[int, int, int]:
    """(rows, first sequence number, places where the next one is not the next), by Arrow alone."""
    rows = gaps = 0
    first = last = -1
    for path in sorted((folder / "samples" / "valve").glob("*.arrows")):
        with pa.ipc.open_stream(path.read_bytes()) as stream, contextlib.suppress(StopIteration):
            while True:
                seq = stream.read_next_batch().column("seq").to_numpy()
                first = int(seq[0]) if first < 0 else first
                gaps += int((np.diff(seq) != 1).sum()) + int(last >= 0 and seq[0] != last + 1)
                last = int(seq[-1])
                rows += len(seq)
    return rows, first, gaps


def main() -> int:
    """Soak; 1 where a sample is missing or memory grows by more than 1 MB an hour."""
    parser = argparse.ArgumentParser(prog="python -m tests.soak", description=__doc__)
    parser.add_argument("--hours", type=float, default=24.0)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        result = soak(args.hours, Path(folder))
    print(json.dumps(result, indent=2))
    return int(bool(result["gaps_in_seq"] or result["faults"] or result["rss_mb_per_hour"] > 1.0))


if __name__ == "__main__":
    sys.exit(main())
