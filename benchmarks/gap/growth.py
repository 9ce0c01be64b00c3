"""Cost of a diagnosis by the number of trials and by the number of effects it may name.

    python -m benchmarks growth_diagnosis

Isometric tables at five lengths with a liner in the muscle, made by the plant itself.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from benchmarks.runs.samples import growth_table

TITLE = "Growth with trials and effects"
REPLICATES = (2, 6, 20, 60, 200)
EFFECTS = (1, 3, 10, 30)
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))


def cost(folder: Path, without: list[str]) -> float:
    """Processor seconds of reading and diagnosing."""
    from gap.data.reader import read_dataset
    from gap.decision.diagnose import diagnose

    start = time.process_time()
    diagnose(read_dataset(folder), without)
    return time.process_time() - start


def measure(tiny: bool = False) -> dict[str, Any]:
    """Costs by number of trials with all effects, and by number of effects at 30 trials."""
    from gap_sets import settled_set
    from plant.effects.catalogue import CATALOGUE

    replicates = (1, 2, 3) if tiny else REPLICATES
    effects = (1, 2, 3) if tiny else EFFECTS
    hidden = {"liner_threshold": {"threshold_kpa": 40.0}}
    names = ["liner_threshold", *sorted(n for n in CATALOGUE if n != "liner_threshold")]
    effects = tuple(min(e, len(names)) for e in effects)
    with tempfile.TemporaryDirectory() as root:
        folders = [settled_set(Path(root) / str(r), hidden, r) for r in replicates]
        middle = folders[min(1, len(folders) - 1)]
        cost(folders[0], [])
        by_trials: list[list[float]] = [[] for _ in replicates]
        by_effects: list[list[float]] = [[] for _ in effects]
        for _ in range(1 if tiny else 3):
            for k, folder in enumerate(folders):
                by_trials[k].append(cost(folder, []))
            for k, count in enumerate(effects):
                by_effects[k].append(cost(middle, names[count:]))
    return {
        "trials": [5 * r for r in replicates], "by_trials": by_trials,
        "effects": list(effects), "by_effects": by_effects,
        "middle": 5 * replicates[min(1, len(replicates) - 1)],
    }  # fmt: skip


def lines(result: dict[str, Any]) -> list[str]:
    """The page's part."""
    trials, effects = result["trials"], result["effects"]
    out = growth_table({"diagnosis": result["by_trials"]}, trials, "trials", 1e3, "ms per trial")
    out += growth_table(
        {f"diagnosis of {result['middle']} trials": result["by_effects"]},
        effects, "effects", 1e3, "ms per effect",
    )  # fmt: skip
    out += ["Processor time, median of three rounds, reading included.", ""]
    return out


if __name__ == "__main__":
    print("\n".join(lines(measure())))
