"""Cost and memory of a run by its length: an isometric test on the virtual bench, repeated.

    python -m benchmarks growth_length

Each length runs in a process of its own, after a short run that loads and compiles everything.
"""

from __future__ import annotations

import dataclasses
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.runs.samples import growth_table
from benchmarks.paired import Growth, table

TITLE = "Growth with the length of a run"
REPEATS = (2, 6, 20, 60, 200)
HOUSE = Path(__file__).resolve().parents[2]


def one(repeats: int) -> dict[str, float]:
    """Simulated seconds, processor seconds and peak memory in MB of one run; then of its table."""
    from analysis.reporting.derived import derive_all
    from rigs.execution.session import run_protocol
    from rigs.protocols.isometric import load_isometric
    from rigs.protocols.registry import procedure
    from rigs.rigfile.config import load_rig

    config = load_rig("virtual")
    plan = load_isometric("isometric-short", config.limits)
    with tempfile.TemporaryDirectory() as root:
        run_protocol(procedure("isometric"), config, plan, Path(root))
        plan = dataclasses.replace(plan, repeats=repeats)
        before, start = peak_mb(), time.process_time()
        result = run_protocol(procedure("isometric"), config, plan, Path(root))
        run_s, run_mb = time.process_time() - start, peak_mb()
        start = time.process_time()
        derive_all(result.folder)
        final = json.loads((result.folder / "final.json").read_text())
        return {
            "seconds": final["duration_s"],
            "run_s": run_s,
            "derive_s": time.process_time() - start,
            "before_mb": before,
            "run_mb": run_mb,
            "derive_mb": peak_mb(),
        }


def peak_mb() -> float:
    """Largest resident size of this process so far."""
    unit = 1e6 if sys.platform == "darwin" else 1e3
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit


def measure(tiny: bool = False) -> dict[str, Any]:
    """All lengths, each in a fresh process."""
    if tiny:
        return {"rows": [one(repeats) for repeats in (1, 2, 3)]}  # 3: a fit needs them
    rows = []
    for repeats in REPEATS:
        done = subprocess.run(
            [sys.executable, "-m", "benchmarks.runs.length", str(repeats)],
            cwd=HOUSE, capture_output=True, text=True, check=True,
        )  # fmt: skip
        rows.append(json.loads(done.stdout))
    return {"rows": rows}


def lines(result: dict[str, Any]) -> list[str]:
    """The page's part."""
    rows = result["rows"]
    sizes = [row["seconds"] for row in rows]
    whole = [round(s) for s in sizes]
    out = growth_table(
        {"the run (bench, firmware, camera, record)": [[r["run_s"]] for r in rows],
         "table, figures, report, view": [[r["derive_s"]] for r in rows]},
        whole, "s of test", 1e3, "ms per second",
    )  # fmt: skip
    memory = [
        [f"{s:,} s", f"{r['before_mb']:.0f}", f"{r['run_mb']:.0f}", f"{r['derive_mb']:.0f}"]
        for s, r in zip(whole, rows, strict=True)
    ]
    heads = ["length", "peak MB before", "peak MB after the run", "after table and report"]
    out += table(heads, memory)
    exponent = Growth.of(sizes, [r["run_mb"] for r in rows])
    out += [
        f"Peak memory during the run grows with length to the power {exponent}.",
        "",
    ]
    return out


if __name__ == "__main__":
    print(json.dumps(one(int(sys.argv[1]))))
