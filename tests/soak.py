"""`python -m tests.soak`: a long run at 1 kHz: is a sample lost, does memory grow?

The real firmware sends through the real driver into a real record, with its balance beside it. By
default on the virtual clock; with ``--real`` the bench is a process of its own on pseudo-terminals
and the record is synced by its threads. Each minute the memory is read; the slope is fitted
to the second half, and at the end the sequence numbers are counted segment by segment, so that
the check itself takes no memory.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import sys
import tempfile
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pyarrow as pa

from daq.errors import DeviceError
from daq.link.telemetry import VALVE_COLUMNS, VALVE_UNITS
from daq.record.writer import RecordWriter
from rigs.bench.rig import Rig, open_rig
from rigs.devices.instruments.balance import BALANCE_SCHEMA, BALANCE_UNITS
from rigs.execution.manifest import software
from rigs.rigfile.config import RigConfig, load_rig

SETPOINTS_KPA = (150.0, 300.0, 450.0, 250.0)
MOST_MB_H = 1.0
"""More than this is growth: what numpy and the allocator hold back comes and goes by less."""


def soak(hours: float, folder: Path, config: RigConfig, tell: bool = True) -> dict[str, Any]:
    """Run so long and judge; plain values."""
    process = psutil.Process()
    memory: list[tuple[float, float]] = []
    faults: list[str] = []
    git = software()["git"] or {}  # now: the checkout may be another one when it ends
    begin_s, cpu = time.monotonic(), process.cpu_times()
    with open_rig(config) as rig:
        virtual = rig.clock.virtual
        if rig.bench is not None:
            rig.bench.board.forget_truth()  # it grows, and is not wanted here
        record = RecordWriter(
            folder, {"protocol": "soak"}, rig.clock, durable=not virtual, threaded=not virtual
        )
        record.stream("valve", VALVE_COLUMNS, VALVE_UNITS)
        record.stream("balance", BALANCE_SCHEMA, BALANCE_UNITS)
        rig.valve.on_batch.append(lambda batch: record.append("valve", batch))
        rig.balance.on_rows.append(lambda batch: record.append("balance", batch))
        if not virtual:
            rig.valve.telemetry.on_ahead = lambda frame: record.write_ahead("valve", frame)
        rig.event_loop.add(lambda: rig.valve.progress(1.0))
        _begin(rig)
        for minute in range(max(1, round(hours * 60))):
            try:
                _minute(rig, config, SETPOINTS_KPA[minute % len(SETPOINTS_KPA)])
            except DeviceError as error:  # a starved host: counted; the samples must go on
                faults += list(rig.valve.faults) or [str(error)]
                _begin_again(rig)
            memory.append(((minute + 1) / 60.0, process.memory_info().rss / 1e6))
            if tell and minute % 60 == 59:
                used_s = process.cpu_times().user - cpu.user
                print(
                    f"{minute / 60:.0f} h, {memory[-1][1]:.0f} MB, {used_s:.0f} s of CPU",
                    flush=True,
                )
        faults += list(rig.valve.faults)
        rig.vent()
        rig.valve.telemetry.flush()
        missing = rig.valve.telemetry.missing
        record.finalize("clean")
    rows, first, gaps = count(record.folder)
    later = np.array(memory[len(memory) // 2 :])
    slope = float(np.polyfit(later[:, 0], later[:, 1], 1)[0]) if len(later) > 2 else 0.0
    used = process.cpu_times()
    return {
        "clock": "virtual" if virtual else "real",
        "hours": hours,
        "rows": rows,
        "first_seq": first,
        "gaps_in_seq": gaps,
        "missing_told": missing,
        "faults": faults,
        "rss_mb": [round(memory[0][1], 1), round(max(m for _, m in memory), 1)],
        "rss_mb_per_hour": round(slope, 3),
        "cpu_s": round(used.user - cpu.user + used.system - cpu.system, 1),
        "took_s": round(time.monotonic() - begin_s),
        "on": f"{datetime.now(UTC):%Y-%m-%d}",
        "revision": str(git.get("revision") or "unknown")[:7] + ("+" if git.get("dirty") else ""),
    }


def _begin(rig: Rig) -> None:
    rig.event_loop.for_seconds(0.5)
    rig.valve.arm()
    rig.valve.request("scheme burst")


def _begin_again(rig: Rig) -> None:
    """As often as it takes: what is asked is whether the samples go on meanwhile."""
    for _ in range(20):
        with contextlib.suppress(DeviceError):
            rig.valve.request("clear", 10.0)
            rig.valve.faults.clear()
            _begin(rig)
            return
    raise DeviceError(rig.valve.name, "cannot be armed any more")


def _minute(rig: Rig, config: RigConfig, pressure_kpa: float) -> None:
    """One set-point held for a minute."""
    rig.valve.set_point(float(config.calibrations["pressure_kpa"].raw(pressure_kpa)))
    rig.event_loop.for_seconds(60.0)
    if rig.valve.fault_latched:
        raise DeviceError(rig.valve.name, "latched a fault")


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


def sound(result: dict[str, Any]) -> bool:
    """No sample missing, no fault, and memory that stands still."""
    lost = result["gaps_in_seq"] or result["missing_told"] or result["faults"]
    return not lost and result["rss_mb_per_hour"] <= MOST_MB_H


TITLE = """# Soak test: 24 virtual hours and one real hour

`make soak` writes this page: `python -m tests.soak --page docs/evidence/soak.md` runs a virtual
day, and `python -m tests.soak --real --page docs/evidence/soak.md` runs one hour in real time
over pseudo-terminals. The simulated controller runs the real firmware at 1 kHz and moves to a
new set-point every minute. Driver and record are the real ones. Afterwards the samples in the
Arrow files are counted by their sequence numbers. Memory is that of the recording program, read
every minute; the slope is that of the second half.

| Clock | Hours | Samples | Lost | Faults | Memory | Peak | Slope | CPU | Took | On | Source |
|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|---|---|
"""
LEGEND = """
*Faults*: the controller vented because the host got no processor time for more than 300 ms (this
cannot happen on the virtual clock). The controller is armed again, and sampling continues.
"""


def write_page(results: list[dict[str, Any]], path: Path) -> None:
    """The newest result of each clock as a page."""
    rows = []
    for result in {r["clock"]: r for r in results}.values():
        lost = max(result["missing_told"], result["gaps_in_seq"])
        cells = [
            result["clock"], f"{result['hours']:g}", f"{result['rows']:,}", lost,
            len(result["faults"]), *(f"{mb:.0f} MB" for mb in result["rss_mb"]),
            f"{result['rss_mb_per_hour']:.2f} MB/h", f"{result['cpu_s']:.0f} s",
            f"{result['took_s'] / 60:.0f} min", result["on"], result["revision"],
        ]  # fmt: skip
        rows.append("| " + " | ".join(map(str, cells)) + " |\n")
    path.write_text(TITLE + "".join(rows) + LEGEND, encoding="utf-8")


def main() -> int:
    """Soak; 1 where a sample is missing or memory grows by more than 1 MB an hour."""
    parser = argparse.ArgumentParser(prog="python -m tests.soak", description=__doc__)
    parser.add_argument("--hours", type=float, help="default: 24; 1 with --real")
    parser.add_argument("--real", action="store_true", help="in real time, over pseudo-terminals")
    parser.add_argument(
        "--results", type=Path, default=Path("out/soak.jsonl"), help="the result is added to it"
    )
    parser.add_argument("--page", type=Path, help="write what was found there, as a page")
    args = parser.parse_args()
    hours = args.hours or (1.0 if args.real else 24.0)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if args.real:
            from .bench_process import bench_process

            with bench_process(folder / "bench") as bench:
                result = soak(hours, folder, load_rig(str(bench.rig)))
        else:
            result = soak(hours, folder, load_rig("virtual"))
    print(json.dumps(result, indent=2))
    args.results.parent.mkdir(parents=True, exist_ok=True)
    with open(args.results, "a", encoding="utf-8") as out:
        out.write(json.dumps(result) + "\n")
    if args.page is not None:
        lines = args.results.read_text(encoding="utf-8").splitlines()
        write_page([json.loads(line) for line in lines], args.page)
    return int(not sound(result))


if __name__ == "__main__":
    sys.exit(main())
