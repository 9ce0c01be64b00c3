"""The whole diagnosis by the number of rows, computed and read from the cache.

    python -m benchmarks growth_rows

Records of valves, loops and hung loads with two effects in them, made by the plant itself.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any
from unittest import mock

from benchmarks.paired import Spread, ratios, short, table

TITLE = "The whole diagnosis by the number of rows"
HIDDEN = {
    "flow_area": {"side": "outlet", "ratio": 1.25},
    "bladder_elasticity": {"stiffness_n_mm": 0.8},
}
REPLICATES, RATE_HZ = 2, 250.0
SIZES = (1, 2, 4)
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))


def cost(folder: Path, known: bool = False) -> tuple[float, float]:
    """Processor and wall seconds of reading, the diagnosis and its fits; `known` to the cache."""
    from gap.data.reader import read_dataset
    from gap.decision.diagnosis import diagnosis

    start, begun = time.process_time(), time.perf_counter()
    found = diagnosis(read_dataset(folder))
    assert found.kept == known
    assert found.problem is not None
    return time.process_time() - start, time.perf_counter() - begun


def sets(root: Path, tiny: bool) -> dict[str, list[Path]]:
    """Folders by what makes the rows more: the rate of the samples, and the number of trials."""
    from gap_bench import write_set
    from gap_sets import settled_set

    if tiny:
        return {"trials": [settled_set(root / f"t{k}", {}, k) for k in SIZES]}
    return {
        "samples per second": [
            write_set(root / f"r{k}", HIDDEN, 3, REPLICATES, rate_hz=k * RATE_HZ) for k in SIZES
        ],
        "trials": [
            write_set(root / f"t{k}", HIDDEN, 4, k * REPLICATES, rate_hz=RATE_HZ) for k in SIZES
        ],
    }


def measure(tiny: bool = False) -> dict[str, Any]:
    """Each size computed, then read, in turns."""
    from gap.data.reader import read_dataset

    rounds = 1 if tiny else 2
    made: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as text:
        root = Path(text)
        by_way = sets(root, tiny)
        for way, folders in by_way.items():
            rows = [
                sum(len(c) for t in read_dataset(f).trials for c in t.channels.values())
                for f in folders
            ]
            made[way] = {"rows": rows, "computed": [[] for _ in folders],
                         "wall": [[] for _ in folders], "read": [[] for _ in folders]}  # fmt: skip
        with mock.patch.dict(os.environ, {"PAMRIG_DIAGNOSES": "off"}):
            cost(by_way["trials"][0])  # loads and compiles everything
        for number in range(rounds):
            with mock.patch.dict(os.environ, {"PAMRIG_DIAGNOSES": str(root / f"kept{number}")}):
                for way, folders in by_way.items():
                    for k, folder in enumerate(folders):
                        cpu, wall = cost(folder)
                        made[way]["computed"][k].append(cpu)
                        made[way]["wall"][k].append(wall)
                        made[way]["read"][k].append(cost(folder, True)[0])
    return made


def lines(result: dict[str, Any]) -> list[str]:
    """The page's part."""
    rows = []
    for way, found in result.items():
        for k, size in enumerate(SIZES):
            computed, read = found["computed"], found["read"]
            rows.append([
                f"{size} x {way}", f"{found['rows'][k]:,}",
                short(Spread.of(computed[k]).median), str(ratios(computed[k], computed[0])),
                short(Spread.of(found["wall"][k]).median),
                short(Spread.of(read[k]).median), str(ratios(computed[k], read[k])),
            ])  # fmt: skip
    heads = [
        "set", "numbers measured", "processor s", "ratio to the first", "wall s",
        "processor s from the cache", "computed / from the cache",
    ]  # fmt: skip
    out = table(heads, rows)
    out += [
        "Reading of the files and setting up of the fits included, start of the program not.", "",
    ]  # fmt: skip
    return out


if __name__ == "__main__":
    print("\n".join(lines(measure())))
