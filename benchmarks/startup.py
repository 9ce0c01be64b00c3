"""From the shell to an answer: `pamrig --help`, and the import that a peer's script begins with.

python -m benchmarks startup
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import time
from typing import Any

from benchmarks.paired import Spread, ratios, short, table

TITLE = "Start-up"
OURS = "pamrig --help"
PEERS = os.environ.get("PAMRIG_BENCH_PYTHON", sys.executable)
WAYS = {
    OURS: [sys.executable, "-m", "cli.main", "--help"],
    "bare Python": [sys.executable, "-c", "pass"],
    "import pamrig": [sys.executable, "-c", "import pamrig"],
    "PyMeasure: import pymeasure.experiment": [PEERS, "-c", "import pymeasure.experiment"],
    "QCoDeS: import qcodes": [PEERS, "-c", "import qcodes"],
    "Bluesky: from bluesky import RunEngine": [PEERS, "-c", "from bluesky import RunEngine"],
}


def once(words: list[str]) -> tuple[float, float] | None:
    """Processor and wall seconds of one process; None if it fails."""
    before, wall = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    done = subprocess.run(words, capture_output=True, check=False)
    after, wall = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter() - wall
    if done.returncode:
        return None
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return cpu, wall


def measure(tiny: bool = False) -> dict[str, Any]:
    """Processor and wall seconds of each way, in rounds that take turns."""
    count = 1 if tiny else 9
    ways = {n: w for n, w in WAYS.items() if once(w) is not None}  # also warms the disk's cache
    found: dict[str, Any] = {n: {"cpu_s": [], "wall_s": []} for n in ways}
    for _ in range(count):
        for name, words in ways.items():
            took = once(words)
            assert took is not None
            found[name]["cpu_s"].append(took[0])
            found[name]["wall_s"].append(took[1])
    missing = [n for n in WAYS if n not in ways]
    return {"rounds": count, "ways": found, "missing": missing, "python": sys.version.split()[0]}


def lines(result: dict[str, Any]) -> list[str]:
    """The page's part."""
    ways = result["ways"]
    rows = []
    for name, took in ways.items():
        times = "" if name == OURS else str(ratios(took["cpu_s"], ways[OURS]["cpu_s"]))
        rows.append(
            [name, short(Spread.of(took["cpu_s"]).median), short(Spread.of(took["wall_s"]).median),
             times]
        )  # fmt: skip
    rows += [[name, "not installed", "", ""] for name in result["missing"]]
    out = table(["what", "processor s", "wall s", "processor time / pamrig"], rows)
    out += [f"Python {result['python']}; {result['rounds']} rounds, files in the disk cache.", ""]
    return out
