"""Inverse dynamics beside Pinocchio and MuJoCo, on the same arms and states.

    python -m benchmarks dynamics

How the tools' arms are built, and more ways, stand in ``benchmarks/links.py``.
"""

from __future__ import annotations

import importlib.metadata
import os
import sys
import tempfile
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from benchmarks import links
from benchmarks.paired import Spread, ratios, rounds, short, table

TITLE = "Inverse dynamics of an arm"
OURS = "pamrig, compiled, batch"
ONE = "pamrig, one state per call"
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))


def differences(arm_name: str) -> dict[str, float]:
    """Largest difference of torque from the compiled kernel, over each state's largest torque."""
    from links_oracles import mujoco_torque, pinocchio_torque
    from plant.links import dynamics, load_arm

    arm = load_arm(arm_name)
    r = np.random.default_rng(2)
    q, qd, qdd = (r.uniform(-top, top, (200, arm.degrees)) for top in (np.pi, 20.0, 500.0))
    ours = dynamics.inverse_dynamics(arm, q, qd, qdd)
    damping = np.array([link.damping_n_m_s for link in arm.links]) * qd
    size = np.abs(ours).max(axis=1)
    others = {
        "Pinocchio": pinocchio_torque(arm, q, qd, qdd) + damping,
        "MuJoCo": mujoco_torque(arm, q, qd, qdd),
    }
    return {n: float((np.abs(o - ours).max(axis=1) / size).max()) for n, o in others.items()}


def measure(tiny: bool = False) -> dict[str, Any]:
    """Processor time a state of each way on two arms."""
    count = 1 if tiny else 15
    arms: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder, mock.patch.dict(os.environ, PAMRIG_CACHE=folder):
        for arm in ("planar3",) if tiny else ("planar3", "finger"):
            ways = {n: w for n, w in links.ways_of(arm).items() if "forward" not in n}
            took = rounds(ways, count)
            arms[arm] = {
                "us": {n: [t / links.STATES * 1e6 for t in f["cpu_s"]] for n, f in took.items()},
                "differences": differences(arm),
            }
    versions = {n: importlib.metadata.version(n) for n in ("pin", "mujoco", "numba")}
    return {"versions": versions, "rounds": count, "arms": arms}


def lines(result: dict[str, Any]) -> list[str]:
    """The page's part."""
    arms = result["arms"]
    rows = []
    for name in next(iter(arms.values()))["us"]:
        row = [name]
        for found in arms.values():
            row.append(short(Spread.of(found["us"][name]).median))
            row.append("" if name == OURS else str(ratios(found["us"][name], found["us"][OURS])))
        rows.append(row)
    heads = ["method"]
    for arm in arms:
        heads += [f"{arm}, us per state", "/ pamrig"]
    out = table(heads, rows)
    versions = ", ".join(f"{n} {v}" for n, v in result["versions"].items())
    worst = max(d for found in arms.values() for d in found["differences"].values())
    out += [
        f"{versions}; {links.STATES} random states, {result['rounds']} rounds, processor time of "
        f"one core. Torques agree to {worst:.0e} of each state's largest. Pinocchio and MuJoCo "
        "accept one state per call from Python; so does pamrig where the table says so "
        "(`plant.links.onestate`, for control loops). Otherwise it accepts arrays.",
        "",
        *_behind(arms),
    ]
    return out


def _behind(arms: dict[str, Any]) -> list[str]:
    """Whoever is quicker than pamrig at one state per call."""
    quicker = []
    for arm, found in arms.items():
        ours = Spread.of(found["us"][ONE]).median
        others = {n: Spread.of(t).median for n, t in found["us"].items() if "pamrig" not in n}
        quicker += [f"{n} ({arm}: {short(t)} us)" for n, t in others.items() if t < ours]
    if not quicker:
        return ["No other method is faster at one state per call.", ""]
    return [f"Faster than pamrig at one state per call: {', '.join(quicker)}.", ""]
