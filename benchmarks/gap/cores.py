"""Blind sets diagnosed on a pool of one process and of two.

python -m benchmarks growth_cores
"""

from __future__ import annotations

import os
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.paired import Spread, ratios, short, table

TITLE = "Growth with cores"
FIRST = 920


def took(jobs: int, count: int) -> float:
    """Wall seconds for so many small sets, after one that loads and compiles everything."""
    from gap.check.campaign import ENGINE, on_pool
    from gap.check.examine import Task

    with tempfile.TemporaryDirectory() as folder:
        seals = str(Path(folder) / "seals.jsonl")
        numbers = range(FIRST, FIRST + count + jobs)
        tasks = [Task("practice", n, True, seals, ENGINE, False) for n in numbers]
        outcomes = on_pool(jobs, tasks)
        for _ in range(jobs):  # each process loads what it needs with its first set
            next(outcomes)
        start = time.perf_counter()
        assert len(list(outcomes)) == count
        return time.perf_counter() - start


def measure(tiny: bool = False) -> dict[str, Any]:
    """Pools of one and two take turns."""
    count, repeats = (1, 1) if tiny else (8, 2)
    found: dict[str, list[float]] = {"1": [], "2": []}
    for _ in range(repeats):
        for jobs in found:
            found[jobs].append(took(int(jobs), count))
    return {"count": count, "wall_s": found, "cores": os.cpu_count(), "load": os.getloadavg()[0]}


def lines(result: dict[str, Any]) -> list[str]:
    """The page's part."""
    wall = result["wall_s"]
    rows = [[f"{jobs}", short(Spread.of(seconds).median)] for jobs, seconds in wall.items()]
    gain = ratios(wall["1"], wall["2"])
    out = table(["processes", f"wall s for {result['count']} sets"], rows)
    out += [
        f"Two processes are **{gain}** times as fast as one on {result['cores']} cores, without "
        "the start of the pool and the first set of each process, at a load of "
        f"{result['load']:.1f} from this and other programs. This is wall time; other programs "
        "also used the second core.",
        "",
    ]
    return out
