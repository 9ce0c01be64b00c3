"""Force of a muscle model on arrays, beside the same equation written in numpy.

python -m benchmarks laws
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from benchmarks.paired import Spread, ratios, rounds, short, table

TITLE = "Force of a muscle model"
POINTS = 1_000_000
HAND = "the equation of Chou and Hannaford, typed in numpy"
SAME = "pamrig, chou-hannaford"
BRAID_LENGTH_M, TURNS = 0.0884, 1.855


def hand(pressure_pa: np.ndarray, length_m: np.ndarray) -> np.ndarray:
    """F = P b^2 / (4 pi n^2) (3 cos^2 - 1), N (Chou and Hannaford 1996): what a user would type."""
    cosine = length_m / BRAID_LENGTH_M
    return pressure_pa * BRAID_LENGTH_M**2 / (4 * np.pi * TURNS**2) * (3 * cosine**2 - 1)


def _ways(names: Sequence[str], points: int) -> dict[str, Callable[[], Any]]:
    from plant.models import catalogue
    from plant.models.law import History

    draw = np.random.default_rng(0)
    p, length = draw.uniform(0, 600e3, points), draw.uniform(52e-3, 67e-3, points)
    seconds: np.ndarray = 1e-3 * np.arange(points, dtype=np.float64)
    t, path = draw.uniform(21, 39, points), History(time_s=seconds)
    ways: dict[str, Callable[[], Any]] = {HAND: lambda: hand(p, length)}
    for name in names:
        model = catalogue.get(name)
        if name == "chou-hannaford":
            model = model.with_values({"braid_length": 1e3 * BRAID_LENGTH_M, "turns": TURNS})
            assert np.allclose(model.force(p, length), hand(p, length), rtol=1e-9, atol=1e-9)
        ways[f"pamrig, {name}"] = lambda model=model: model.force(p, length, t, path)  # type: ignore[misc]
    return ways


def measure(tiny: bool = False) -> dict[str, Any]:
    """Processor time of each model for a million points."""
    from plant.models import catalogue
    from plant.models.model import OutsideDomain

    points, count = (1000, 1) if tiny else (POINTS, 9)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", OutsideDomain)
        took = rounds(_ways(["chou-hannaford"] if tiny else catalogue.names(), points), count)
    return {
        "points": points,
        "rounds": count,
        "ms": {name: [1e3 * t for t in found["cpu_s"]] for name, found in took.items()},
    }


def lines(result: dict[str, Any]) -> list[str]:
    """The page's part."""
    times = result["ms"]
    rows = [
        [name, short(Spread.of(t).median), "" if name == SAME else str(ratios(t, times[SAME]))]
        for name, t in times.items()
    ]
    out = table(["method", f"ms for {result['points']:,} points", f"/ {SAME}"], rows)
    out += [
        f"{result['rounds']} rounds, processor time of one core. Both ways of `chou-hannaford` "
        "give the same forces. The models also check their domain; those with memory (`play`, "
        "`slip`, `late`) follow the order of the points.",
        "",
    ]
    return out
