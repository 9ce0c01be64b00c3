"""Brings bench.csv into the dataset format: other names, other units, one table of trials.

python convert.py bench.csv mydata
"""

from __future__ import annotations

import sys
from pathlib import Path

import pandas as pd


def convert(source: Path, folder: Path) -> None:
    """Write `trials.csv` (one row a run) and `samples.csv` (one row a point)."""
    table = pd.read_csv(source)
    folder.mkdir(parents=True, exist_ok=True)
    runs = table.groupby("run", as_index=False).first()
    pd.DataFrame(
        {
            "trial": runs["run"],
            "slot": "L" + runs["L [mm]"].astype(str),  # runs of one slot are replicates
            "replicate": runs["repeat"],
            "protocol": "isometric",
            "order": runs["run"],
            "held_length_mm": runs["L [mm]"],
        }
    ).to_csv(folder / "trials.csv", index=False)
    pd.DataFrame(
        {
            "trial": table["run"],
            "pressure_kpa": 100.0 * table["p [bar]"],
            "force_n": table["F [N]"],
            "direction": table["way"].map({"+": "up", "-": "down"}),
        }
    ).to_csv(folder / "samples.csv", index=False)


if __name__ == "__main__":
    convert(Path(sys.argv[1]), Path(sys.argv[2]))
