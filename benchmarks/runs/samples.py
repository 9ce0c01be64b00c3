"""Cost of samples: recorded, read back, verified, and made into a table; over two decades.

python -m benchmarks growth_samples
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks.paired import Growth, Spread, short, table

TITLE = "Growth with samples"
SIZES = (10_000, 30_000, 100_000, 300_000, 1_000_000)
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))


def steps(root: Path, rows: int) -> dict[str, float]:
    """Processor seconds of each step with so many samples of the valve's stream."""
    from daq.store.derive import derive
    from daq.store.run import open_run
    from daq.store.verify import verify
    from daq_records import begin, valve_batch

    batch = valve_batch(0)
    out: dict[str, float] = {}

    def clocked(name: str, work: Callable[[], Any]) -> Any:
        start = time.process_time()
        result = work()
        out[name] = time.process_time() - start
        return result

    def record() -> Path:
        writer, _ = begin(root, durable=False, threaded=False, segment_rows=300_000)
        for first in range(0, rows, 50):
            batch["seq"] = batch["seq"] % 50 + first
            writer.append("valve", batch)
        writer.finalize("clean")
        return Path(writer.folder)

    folder = clocked("record", record)
    clocked("read", lambda: open_run(folder).samples("valve"))
    clocked("verify", lambda: verify(open_run(folder)))
    clocked("table of engineering units", lambda: derive(open_run(folder)))
    return out


def measure(tiny: bool = False) -> dict[str, Any]:
    """Costs by step and size; sizes take turns."""
    sizes = (500, 1_000, 2_000) if tiny else SIZES
    costs: dict[str, list[list[float]]] = {}
    with tempfile.TemporaryDirectory() as folder:
        steps(Path(folder), 1_000)
        for number in range(1 if tiny else 3):
            for k, rows in enumerate(sizes):
                for name, cost in steps(Path(folder) / f"{number}-{rows}", rows).items():
                    costs.setdefault(name, [[] for _ in sizes])[k].append(cost)
    return {"sizes": list(sizes), "costs": costs}


def lines(result: dict[str, Any]) -> list[str]:
    """The page's part."""
    return [
        *growth_table(result["costs"], result["sizes"], "samples", 1e6, "us per sample"),
        "Processor time, median of three rounds. One decade of 1 kHz is 17 min, two are 2.8 h.",
        "",
    ]


def growth_table(
    costs: dict[str, list[list[float]]], sizes: list[int], what: str, scale: float, unit: str
) -> list[str]:
    """Costs a unit at the smallest and the largest size, and the exponents."""
    rows = []
    for name, by_size in costs.items():
        middle = [Spread.of(c).median for c in by_size]
        half = len(sizes) // 2
        rows.append([
            name,
            short(middle[0] / sizes[0] * scale),
            short(middle[-1] / sizes[-1] * scale),
            str(Growth.of(sizes, middle)),
            f"{Growth.of(sizes[half:], middle[half:]).exponent:.3f}",
        ])  # fmt: skip
    heads = [
        "cost of", f"{unit} at {sizes[0]:,} {what}", f"at {sizes[-1]:,}",
        "exponent (95 % interval)", "upper half alone",
    ]  # fmt: skip
    return table(heads, rows)


if __name__ == "__main__":
    print("\n".join(lines(measure())))
