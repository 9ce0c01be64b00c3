"""An hour of protocol on the virtual clock, and what recording it durably costs."""

from __future__ import annotations

import dataclasses
import tempfile
import time
from pathlib import Path

from analysis.reporting.derived import derive_all
from daq.store.run import open_run
from daq.store.verify import verify
from rigs.execution.session import run_protocol
from rigs.protocols.isometric import load_isometric
from rigs.protocols.registry import procedure
from rigs.rigfile.config import load_rig


def main(repeats: int = 20) -> None:
    """Run, read back, verify and derive; prints processor and wall seconds of each."""
    config = load_rig("virtual")
    plan = dataclasses.replace(load_isometric("isometric", config.limits), repeats=repeats)
    with tempfile.TemporaryDirectory() as root:
        rows = []

        def clocked(what: str, work: object) -> object:
            wall, cpu = time.monotonic(), time.process_time()
            result = work()  # type: ignore[operator]
            rows.append((what, time.process_time() - cpu, time.monotonic() - wall))
            return result

        result = clocked(
            "run", lambda: run_protocol(procedure("isometric"), config, plan, Path(root))
        )
        run = open_run(result.folder)  # type: ignore[attr-defined]
        clocked("read all samples", lambda: run.samples("valve"))
        clocked("verify every byte", lambda: verify(run))
        clocked("table, report, view", lambda: derive_all(run.folder))
        seconds = run.final["duration_s"] if run.final else 0.0
        size = sum(p.stat().st_size for p in run.folder.rglob("*") if "derived" not in p.parts)
        print(f"{seconds:.0f} s of test at 1 kHz, {size / 1e6:.0f} MB of record")
        print("| what | processor s | wall s |\n|--|--|--|")
        for what, cpu, wall in rows:
            print(f"| {what} | {cpu:.1f} | {wall:.1f} |")


if __name__ == "__main__":
    main()
