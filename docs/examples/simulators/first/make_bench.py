"""Writes bench.csv: measurements of a muscle as another laboratory might hand them over.

The muscle follows Tondu and Lopez (2000), F = pi r^2 p (a (1 - k e)^2 - b), which is not the
nominal plant of this package. Two things are not in that formula: noise, and dry friction of the
braid. Pressure presses its fibres together: at 3 bar friction takes 4 N on the way up and adds 4 N
on the way down, at other pressures in proportion.

    python make_bench.py bench.csv
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pandas as pd

RADIUS_MM, ANGLE_DEG, REST_MM, ENDS = 4.55, 20.0, 70.0, 1.15
FRICTION_N, AT_BAR = 4.0, 3.0
LENGTHS_MM = (56.0, 59.0, 62.0, 65.0, 68.0)
BAR = (0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 4.0, 3.0, 2.0, 1.0, 0.0)


def force_n(bar: np.ndarray, length_mm: np.ndarray) -> np.ndarray:
    """Tondu and Lopez (2000), with a pressure in bar."""
    angle = np.radians(ANGLE_DEG)
    a, b = 3.0 / np.tan(angle) ** 2, 1.0 / np.sin(angle) ** 2
    shortened = 1.0 - length_mm / REST_MM
    area_mm2 = np.pi * RADIUS_MM**2
    return area_mm2 * 0.1 * bar * (a * (1.0 - ENDS * shortened) ** 2 - b)


def bench(seed: int = 5) -> pd.DataFrame:
    """Three runs at each of five lengths, up and down, in random order."""
    rng = np.random.default_rng(seed)
    rows = []
    runs = [(length, repeat) for repeat in (1, 2, 3) for length in rng.permutation(LENGTHS_MM)]
    for number, (length, repeat) in enumerate(runs, start=1):
        bar = np.array(BAR)
        up = np.arange(len(bar)) <= np.argmax(bar)
        friction = np.where(up, -FRICTION_N, FRICTION_N) * bar / AT_BAR
        force = force_n(bar, np.full(len(bar), length)) + friction
        zero_bar, zero_n = rng.normal(0.0, 0.003), rng.normal(0.0, 0.1)
        for k in range(len(bar)):
            rows.append(
                {
                    "run": number, "repeat": repeat, "L [mm]": length, "way": "+" if up[k] else "-",
                    "p [bar]": round(bar[k] + zero_bar + rng.normal(0.0, 0.002), 4),
                    "F [N]": round(force[k] + zero_n + rng.normal(0.0, 0.05), 2),
                }
            )  # fmt: skip
    return pd.DataFrame(rows)


if __name__ == "__main__":
    bench().to_csv(Path(sys.argv[1]), index=False)
