"""Link dynamics side by side, in one run: agreement, drift of energy, speed.

The same 1,000 random states of the same arm to each; rounds take turns, so that a busy machine is
busy for all; the best round counts. The tools' arms are built by the tests' own builders.
"""

from __future__ import annotations

import importlib.metadata
import os
import platform
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from unittest import mock

import numpy as np

STATES = 1000
ROUNDS = 15


def measured(ways: dict[str, Callable[[], object]]) -> dict[str, float]:
    """Microseconds per state of each way, the best of rounds that take turns."""
    best = dict.fromkeys(ways, float("inf"))
    for way in ways.values():
        way()
    for _ in range(ROUNDS):
        for name, way in ways.items():
            begin = time.perf_counter()
            way()
            best[name] = min(best[name], (time.perf_counter() - begin) / STATES * 1e6)
    return best


def ways_of(arm_name: str) -> dict[str, Callable[[], object]]:
    import mujoco
    import pinocchio

    from links_oracles import mujoco_arm, pinocchio_arm
    from plant.links import dynamics as dyn
    from plant.links import load_arm
    from plant.links.onestate import OneState
    from plant.links.symbolic.generated import generated

    arm = load_arm(arm_name)
    r = np.random.default_rng(1)
    q, qd, qdd = (r.uniform(-top, top, (STATES, arm.degrees)) for top in (np.pi, 20.0, 500.0))
    rows = list(zip(q, qd, qdd, strict=True))
    torque = dyn.inverse_dynamics(arm, q, qd, qdd)
    symbolic = generated(arm)
    pin_model, mj_model = pinocchio_arm(arm), mujoco_arm(arm)
    pin_data, mj_data = pin_model.createData(), mujoco.MjData(mj_model)
    rnea, mj_inverse = pinocchio.rnea, mujoco.mj_inverse

    def each_pinocchio() -> None:
        for a, b, c in rows:
            rnea(pin_model, pin_data, a, b, c)

    def each_mujoco() -> None:
        # The call alone, on one state: setting the state would only add to it.
        for _ in range(STATES):
            mj_inverse(mj_model, mj_data)

    one = OneState(arm).inverse_dynamics

    def each_ours() -> None:
        for a, b, c in rows:
            one(a, b, c)

    def each_array() -> None:
        for a, b, c in rows:
            dyn.inverse_dynamics(arm, a, b, c)

    mj_data.qpos, mj_data.qvel, mj_data.qacc = q[0], qd[0], qdd[0]
    return {
        "pamrig, compiled, batch": lambda: dyn.inverse_dynamics(arm, q, qd, qdd),
        "pamrig, equations in numpy, batch": lambda: symbolic.inverse_dynamics(q, qd, qdd),
        "pamrig, one state per call": each_ours,
        "pamrig, batches of one state": each_array,
        "Pinocchio rnea, Python call": each_pinocchio,
        "MuJoCo mj_inverse, Python call": each_mujoco,
        "pamrig, forward dynamics, batch": lambda: dyn.forward_dynamics(arm, q, qd, torque),
    }


def agreement(arm_name: str) -> None:
    """Largest differences from the compiled kernel, as shares of each state's largest torque."""
    import sympy

    from links_oracles import mujoco_torque, pinocchio_torque
    from plant.links import dynamics as dyn
    from plant.links import load_arm
    from plant.links.motion import swing
    from plant.links.newton_euler import newton_euler
    from plant.links.symbolic.generated import generated
    from plant.links.symbolic.lagrange import derive

    arm = load_arm(arm_name)
    r = np.random.default_rng(2)
    q, qd, qdd = (r.uniform(-top, top, (STATES, arm.degrees)) for top in (np.pi, 20.0, 500.0))
    ours = dyn.inverse_dynamics(arm, q, qd, qdd)
    damping = np.array([link.damping_n_m_s for link in arm.links])
    plain = [newton_euler(arm, *row) for row in zip(q, qd, qdd, strict=True)]
    others = {
        "symbolic": generated(arm).inverse_dynamics(q, qd, qdd),
        "plain": np.array(plain),
        "Pinocchio": pinocchio_torque(arm, q, qd, qdd) + damping * qd,
        "MuJoCo": mujoco_torque(arm, q, qd, qdd),
    }
    size = np.abs(ours).max(axis=1)
    for name, theirs in others.items():
        print(f"  {name:10s} {(np.abs(theirs - ours).max(axis=1) / size).max():.1e}")
    e = derive(arm)
    arguments = [*e.q, *e.qd, *map(sympy.Symbol, e.parameters)]
    rate = sympy.lambdify(arguments, sympy.Matrix(e.inertia_rate()), cse=True)
    worst = 0.0
    for row, speed, c in zip(q, qd, dyn.coriolis_matrix(arm, q, qd), strict=True):
        skew = rate(*row, *speed, *e.parameters.values()) - 2.0 * c
        worst = max(worst, float(np.abs(skew + skew.T).max() / np.abs(c).max()))
    print(f"  D' - 2C, symmetric part  {worst:.1e} of C")
    n = arm.degrees
    motion = swing(arm.without_damping(), np.full(n, 0.5), np.linspace(1.0, 3.0, n), 10.0)
    print(f"  drift over 10 s          {motion.drift:.1e}")


def derivation_s() -> float:
    from plant.links import load_arm
    from plant.links.symbolic.lagrange import derive

    arm = load_arm("finger").with_payload(0.001)  # one that nothing has derived yet
    begin = time.perf_counter()
    derive(arm)
    return time.perf_counter() - begin


def main() -> None:
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))
    versions = [f"{n} {importlib.metadata.version(n)}" for n in ("pin", "mujoco", "numba", "numpy")]
    print(f"Python {platform.python_version()}, {', '.join(versions)}")
    print(f"{os.cpu_count()} processors, load {os.getloadavg()[0]:.1f}")
    with tempfile.TemporaryDirectory() as folder, mock.patch.dict(os.environ, PAMRIG_CACHE=folder):
        for arm in ("planar2", "planar3", "finger"):
            print(f"\n{arm}: {STATES} random states, largest difference from the compiled kernel")
            agreement(arm)
        for arm in ("planar3", "finger"):
            best = measured(ways_of(arm))
            ours = best["pamrig, compiled, batch"]
            print(f"\n{arm}: microseconds per state, best of {ROUNDS} rounds of {STATES}")
            for name, value in best.items():
                print(f"  {name:36s} {value:8.3f}   {value / ours:6.1f} times the first")
    print(f"\nfinger, equations derived in symbols in {derivation_s():.2f} s")


if __name__ == "__main__":
    main()
