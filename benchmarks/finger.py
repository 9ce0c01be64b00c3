"""The finger's speed: plant alone, with the firmware in the loop, and what one would use instead.

    python -m benchmarks.finger

One run, rounds take turns, the best round counts; time is CPU time of one core, so that others on
the machine disturb little. The valve commands are those of the feed-forward law on the circle,
recorded. SciPy solves the same equations over a stretch without edges; errors of both are printed.
"""

from __future__ import annotations

import os
import platform
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

ROUNDS = 5
TICK_S = 1e-3


def recorded(valve: str, seconds: float) -> tuple[Any, float]:
    """Valve commands (ticks, 8, 2) of a closed loop with its firmware, and how fast that ran."""
    from plant.finger import FingerSim, load_finger
    from plant.finger.reader import load_valve
    from studies.controllers import loop
    from studies.controllers.laws import build_law
    from studies.controllers.reference import circle

    finger, c = load_finger(), load_valve(valve)
    law, scheme = build_law("feedforward", finger, c)
    reference = circle(finger, turns=max(1, round((seconds - 2.0) / 4.0)))
    kept: list[Any] = []

    class Recording(FingerSim):
        def advance(self, dt_s: float, on_s: Any) -> None:
            kept.append(on_s.copy())
            super().advance(dt_s, on_s)

    plain = loop.FingerSim
    begin = time.process_time()
    try:
        loop.FingerSim = Recording  # type: ignore[misc]
        loop.run_law(finger, c, law, reference, scheme=scheme)
    finally:
        loop.FingerSim = plain  # type: ignore[misc]
    taken = time.process_time() - begin
    return np.array(kept), len(kept) * TICK_S / taken


def best(ways: dict[str, Callable[[], float]]) -> dict[str, float]:
    """Simulated seconds per CPU second of each way, the best of rounds that take turns."""
    top = dict.fromkeys(ways, 0.0)
    for _ in range(ROUNDS):
        for name, way in ways.items():
            begin = time.process_time()
            simulated = way()
            top[name] = max(top[name], simulated / (time.process_time() - begin))
    return top


def main() -> None:
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))
    import mujoco

    from links_oracles import mujoco_arm
    from plant.finger import FingerSim, load_finger
    from plant.finger.reader import load_valve
    from plant.links.dynamics import gravity_torque
    from studies.controllers.muscles import Pairs
    from test_finger_plant import independent

    finger = load_finger()
    commands = {}
    print(f"Python {platform.python_version()}, {os.cpu_count()} processors, "
          f"load {os.getloadavg()[0]:.1f}")  # fmt: skip
    for valve in ("cured", "thesis"):
        commands[valve], loop_speed = recorded(valve, 10.0)
        edges = int(np.sum(np.diff((commands[valve] > 0).astype(int), axis=0) > 0))
        print(f"{valve} valve: {len(commands[valve])} ms, {edges} commands; with eight firmwares "
              f"in Python in the loop {loop_speed:.0f} times real time")  # fmt: skip

    def ours(valve: str) -> Callable[[], float]:
        def way() -> float:
            FingerSim(finger, load_valve(valve)).replay(TICK_S, commands[valve])
            return len(commands[valve]) * TICK_S

        return way

    still = np.zeros((5000, 8, 2))

    def quiet() -> float:
        FingerSim(finger, load_valve("cured"), pressure_kpa=250.0).replay(TICK_S, still)
        return 5.0

    model = mujoco_arm(finger.arm)
    data = mujoco.MjData(model)

    def links_only(integrator: Any, step_s: float) -> Callable[[], float]:
        def way() -> float:
            model.opt.integrator, model.opt.timestep = integrator, step_s
            mujoco.mj_resetData(model, data)
            mujoco.mj_step(model, data, round(5.0 / step_s))
            return 5.0

        return way

    c = load_valve("cured")
    q = np.radians([0.0, 10.0, 25.0, 25.0])
    pairs = Pairs(finger, c)
    pressure = pairs.pressures(pairs.delta(q, gravity_torque(finger.arm, q))) * 1e3

    valves = ([2, 5], [3, 4])
    open_c = c.with_overrides({"inlet_on_ms": 0.0, "outlet_on_ms": 0.0})
    on = np.zeros((50, 8, 2))
    on[:, valves[0], 0] = on[:, valves[1], 1] = TICK_S

    def stretch() -> Any:
        sim = FingerSim(finger, open_c, q_rad=q, pressure_kpa=pressure * 1e-3)
        return sim.replay(TICK_S, on)[-1, :4]

    def scipys() -> float:
        independent(finger, open_c, q, pressure, *valves, 0.05, rtol=1e-3)
        return 0.05

    exact, _ = independent(finger, open_c, q, pressure, *valves, 0.05)
    loose, _ = independent(finger, open_c, q, pressure, *valves, 0.05, rtol=1e-3)
    errors = [np.degrees(np.abs(q_end - exact).max()) for q_end in (stretch(), loose)]
    print("error after 50 ms of open valves: "
          f"pamrig {errors[0]:.1e}, SciPy {errors[1]:.1e} degrees")  # fmt: skip

    speeds = best(
        {
            "pamrig, recorded commands, cured valve": ours("cured"),
            "pamrig, recorded commands, thesis valve": ours("thesis"),
            "pamrig, all valves shut": quiet,
            "SciPy Radau, one stretch between edges": scipys,
            "MuJoCo, links alone, RK4, 0.25 ms": links_only(mujoco.mjtIntegrator.mjINT_RK4, 2.5e-4),
            "MuJoCo, links alone, implicitfast, 1 ms": links_only(
                mujoco.mjtIntegrator.mjINT_IMPLICITFAST, 1e-3
            ),
        }
    )
    first = next(iter(speeds.values()))
    print(f"\ntimes real time, best of {ROUNDS} rounds")
    for name, value in speeds.items():
        print(f"  {name:42s} {value:9.1f}   {first / value:8.2f} times slower than the first")


if __name__ == "__main__":
    main()
