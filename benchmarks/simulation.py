"""Valve, muscle and load simulated: beside SciPy on the same equations, and MuJoCo's cylinder.

    python -m benchmarks simulation

What is simulated and how errors are found stands in ``benchmarks/scene.py``, which has more ways.
"""

from __future__ import annotations

import importlib.metadata
from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks import scene
from benchmarks.paired import Spread, ratios, rounds, short, table

TITLE = "Simulation of valve, muscle and load"
OURS = "pamrig, compiled scene"


def measure(tiny: bool = False) -> dict[str, Any]:
    """Processor seconds a simulated second of each way, and its largest error."""
    long_s, short_s, count = (2.0, 0.25, 1) if tiny else (100.0, 2.0, 7)
    reference = scene.scipy_run(short_s, 1e-11)

    def error(trace: np.ndarray) -> list[float]:
        off = np.abs(trace[: len(reference)] - reference).max(axis=0)
        return [float(off[0]) * 1e-3, float(off[1]) * 1e6]

    ours = error(scene.scene_run(short_s))
    chosen = next(
        (t for t in (1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9)
         if all(a <= b for a, b in zip(error(scene.scipy_run(short_s, t)), ours, strict=True))),
        1e-11,
    )  # fmt: skip
    equal = f"SciPy solve_ivp, rtol {chosen:g}: no more error"
    ways: dict[str, tuple[float, Callable[[], object], list[float]]] = {
        OURS: (long_s, lambda: scene.scene_run(long_s), ours),
        equal: (short_s, lambda: scene.scipy_run(short_s, chosen),
                error(scene.scipy_run(short_s, chosen))),
        "SciPy solve_ivp, rtol 0.001: its default": (
            short_s, lambda: scene.scipy_run(short_s, 1e-3), error(scene.scipy_run(short_s, 1e-3))),
    }  # fmt: skip
    for integrator in ("Euler", "implicitfast", "RK4"):
        go = scene.mujoco_run(long_s, integrator)
        ways[f"MuJoCo cylinder, {integrator}, 1 ms"] = (long_s, go, [])
    took = rounds({name: way[1] for name, way in ways.items()}, count)
    return {
        "versions": {n: importlib.metadata.version(n) for n in ("scipy", "mujoco", "numba")},
        "rounds": count,
        "ways": {
            name: {
                "cost": [t / seconds for t in took[name]["cpu_s"]],
                "error": off,
            }
            for name, (seconds, _, off) in ways.items()
        },
    }


def lines(result: dict[str, Any]) -> list[str]:
    """The page's part."""
    ways = result["ways"]
    rows = []
    for name, way in ways.items():
        times = "" if name == OURS else str(ratios(way["cost"], ways[OURS]["cost"]))
        off = [short(e) for e in way["error"]] or ["other equations", ""]
        speed = short(1.0 / Spread.of(way["cost"]).median)
        rows.append([name, speed, times, *off])
    out = table(["method", "times real time", "time / pamrig", "largest error, kPa", "um"], rows)
    versions = ", ".join(f"{n} {v}" for n, v in result["versions"].items())
    out += [
        f"{versions}; {result['rounds']} rounds, processor time of one core. The valve of the "
        "thesis, one muscle, 3 kg, fills and vents of 12 to 25 ms; errors against "
        "`solve_ivp` at 1e-11. "
        "MuJoCo's `<cylinder>` is a first-order filter of the command on a constant area: no gas, "
        "no valve, no muscle. It is the alternative for a user, but not the same model.",
        "",
    ]
    behind = [
        n for n, w in ways.items()
        if n != OURS and ratios(w["cost"], ways[OURS]["cost"]).median < 1.0
    ]  # fmt: skip
    if behind:
        out += [f"Faster than pamrig: {', '.join(behind)}.", ""]
    return out
