"""Valve, muscle and load in simulation, side by side in one run: speed at what error.

    python -m benchmarks.scene             # a table
    python -m benchmarks.scene --json

The same recorded valve commands (fills and vents of 12 to 25 ms on the valve of the thesis) to
the same muscle with 3 kg hung on it, between its stops:

- the compiled scene (`plant.scene.scene`), and the single bench's kernel
(`plant.simulator.simulate`);
- SciPy's `solve_ivp` on the same equations in plain Python, pieced together at every valve edge and
  stop, with the tolerance that gives it the scene's own error (or less);
- MuJoCo's pneumatic cylinder: a first-order filter of the command and a constant area, moving the
  same mass. It has no gas, no valve and no muscle; it is what a user would take instead.

Errors are against `solve_ivp` at 1e-11, the largest over all milliseconds. Then the scene under the
firmware's Python, one controller a muscle, and the same with the scheme's step alone.
"""

from __future__ import annotations

import json
import os
import platform
import sys
import time
from collections.abc import Callable

import numpy as np

from plant.constants import nominal
from plant.physics import layout
from plant.scene import kernel as scene_kernel
from plant.simulator.simulate import commands, run_commands
from rigs.virtual.board.scene_loop import SceneLoop
from studies.schemes.trial import Bench, run_trial
from studies.simulation.scenario import load_scenario
from studies.simulation.session import build_scene, firmware_values

MASS_KG = 3.0
START_M = 0.066
LONG_S = 200.0
SHORT_S = 2.0
ROUNDS = 5
C = nominal()


def edges(duration_s: float) -> list[tuple[float, int, float]]:
    """(time, solenoid 0 inlet or 1 outlet, value): a fill and a vent each 250 ms, none alike."""
    rng = np.random.default_rng(11)
    out = []
    for k in range(int(duration_s / 0.25)):
        begin = 0.25 * k
        for which, at in ((0, 0.01), (1, 0.13)):
            width = float(rng.uniform(0.012, 0.025))
            out += [(begin + at, which, 1.0), (begin + at + width, which, 0.0)]
    return out


def scene_run(duration_s: float, step_share: float = 1.0) -> np.ndarray:
    from plant.scene.scene import Coordinate, Scene, Unit

    load = Coordinate(
        "load", mass=MASS_KG, pull=MASS_KG * 9.80665, damping=C.load_damping_n_s_m,
        low=C.length_min_m, high=C.length_max_m, stop_stiffness=C.stop_stiffness_n_m,
        stop_damping=C.stop_damping_n_s_m, start=START_M,
    )  # fmt: skip
    scene = Scene([Unit("muscle", C, reach={"load": 1.0})], [load], step_share=step_share)
    time_s, which, value = (np.array(c) for c in zip(*edges(duration_s), strict=True))
    sample = np.arange(round(duration_s * 1000) + 1) * 1e-3
    out = np.zeros((len(sample), 7))
    scene_kernel.replay(
        scene.world, time_s, np.zeros(len(time_s), np.int64), which.astype(np.int64),
        value.astype(np.float64), sample, out,
    )  # fmt: skip
    return out[:, :2]


def bench_run(duration_s: float) -> np.ndarray:
    names = ("inlet", "outlet")
    rows = commands([(t, names[w], v) for t, w, v in edges(duration_s)])  # type: ignore[misc]
    traces = run_commands(C, rows, duration_s, load="isotonic", length_m=START_M, mass_kg=MASS_KG)
    return np.column_stack([traces.pressure_kpa * 1e3, traces.length_mm * 1e-3])


def scipy_run(duration_s: float, tolerance: float) -> np.ndarray:
    """The same equations by a careful user: pieces between edges, stops as events."""
    import math

    from scipy.integrate import solve_ivp

    b, n, atm = C.braid_length_m, C.turns, C.atmosphere_pa
    rt, rho = 287.05 * C.gas_temperature_k, 1.185
    supply, cond = C.supply_pa + atm, C.inlet_conductance_m3_s_pa
    low, high = C.length_min_m, C.length_max_m
    four_pi = 4.0 * math.pi * n * n

    def psi(r: float) -> float:
        if r <= 0.5:
            return 1.0
        return math.sqrt(max(0.0, 1.0 - ((r - 0.5) / 0.5) ** 2))

    def rates(t: float, y: np.ndarray, inlet: bool, outlet: bool) -> list[float]:
        p, length, speed = y
        volume = (b * b * length - length**3) / four_pi + C.dead_volume_m3
        flow = 0.0
        if inlet and p < supply:
            flow += cond * rho * supply * psi(p / supply)
        if outlet and p > atm:
            flow -= cond * rho * p * psi(atm / p)
        dp = (rt * flow - p * (b * b - 3 * length * length) / four_pi * speed) / volume
        push = 0.0
        if length < low:
            push = max(0.0, 20e3 * (low - length) - 20.0 * speed)
        elif length > high:
            push = -max(0.0, 20e3 * (length - high) + 20.0 * speed)
        pull = (p - atm) * (3 * length * length - b * b) / four_pi
        return [dp, speed, 9.80665 + (push - pull - C.load_damping_n_s_m * speed) / MASS_KG]

    def touch_low(t: float, y: np.ndarray, *_: bool) -> float:
        return float(y[1] - low)

    def touch_high(t: float, y: np.ndarray, *_: bool) -> float:
        return float(y[1] - high)

    touch_low.terminal = touch_high.terminal = True  # type: ignore[attr-defined]
    pending: list[tuple[float, int, bool]] = []
    todo, is_open, y, now = edges(duration_s), [False, False], np.array([atm, START_M, 0.0]), 0.0
    sample = np.arange(round(duration_s * 1000) + 1) * 1e-3
    out = np.zeros((len(sample), 2))
    out[0] = y[0] - atm, y[1]
    done = 1
    while now < duration_s:
        until = min([duration_s, *(e[0] for e in todo[:1]), *(p[0] for p in pending)])
        while now < until - 1e-13:
            wanted = sample[done : np.searchsorted(sample, until, side="right")]
            wanted = np.unique([*wanted[wanted < until - 1e-10], until])
            r = solve_ivp(
                rates, (now, until), y, args=tuple(is_open), method="RK45", rtol=tolerance,
                atol=[tolerance * 1e5, tolerance * 0.05, tolerance], t_eval=wanted,
                events=(touch_low, touch_high),
            )  # fmt: skip
            ended = r.status == 1
            got = [k for k, t in enumerate(r.t) if done < len(sample) and t >= sample[done] - 1e-12]
            for k in got:
                if done < len(sample) and abs(r.t[k] - sample[done]) < 1e-10:
                    out[done] = r.y[0, k] - atm, r.y[1, k]
                    done += 1
            if ended:
                which = 0 if len(r.t_events[0]) else 1
                now, y = float(r.t_events[which][-1]), r.y_events[which][-1].copy()
                y[1] += 1e-12 * np.sign(y[2])
            else:
                now, y = until, r.y[:, -1]
        now = until
        for edge in [p for p in pending if p[0] <= now]:
            pending.remove(edge)
            is_open[edge[1]] = edge[2]
        while todo and todo[0][0] <= now:
            at, which, value = todo.pop(0)
            kpa = 550.0 if which == 0 else (y[0] - atm) / 1e3
            on = value > 0.0
            first = (8.70 + 0.00395 * kpa, 9.28 + 0.00174 * kpa)[which]
            last = (8.94 - 0.00080 * kpa, 8.82 - 0.00058 * kpa)[which]
            pending.append((at + (first if on else last) * 1e-3, which, on))
    return out


MUJOCO = """
<mujoco><option timestep="0.001" gravity="0 0 -9.81" integrator="{integrator}"/><worldbody>
<body><joint name="j" type="slide" axis="0 0 1" damping="5" limited="true" range="-0.02 0.02"/>
<geom size="0.05" mass="3"/></body></worldbody>
<actuator><cylinder joint="j" timeconst="0.05" area="7e-5" bias="0 0 0"/></actuator></mujoco>
"""


def mujoco_run(duration_s: float, integrator: str) -> Callable[[], None]:
    import mujoco

    model = mujoco.MjModel.from_xml_string(MUJOCO.format(integrator=integrator))

    def go() -> None:
        data = mujoco.MjData(model)
        for k in range(round(duration_s * 100)):
            data.ctrl[0] = 550e3 if k % 25 < 2 else 0.0
            mujoco.mj_step(model, data, nstep=10)

    return go


def firmware_speed(name: str, seconds: float = 2.0) -> float:
    """Simulated over processor seconds with every controller's Python in the loop."""
    scenario = load_scenario(name)
    scene = build_scene(scenario)
    counts = 4095 / scenario.sensors.pressure_range_kpa
    values = [firmware_values(scenario, k, counts) for k in range(len(scenario.muscles))]
    loop = SceneLoop(scene, 1, None, values, [lambda t, d: None] * len(values))
    loop.boot()
    for k in range(len(values)):
        loop.ask(k, "scheme burst")
        loop.ask(k, f"sp {round(200 * counts * 16)}")
    loop.run_ms(100)
    begin = time.process_time()
    loop.run_ms(round(seconds * 1000))
    return seconds / (time.process_time() - begin)


def best_of(go: Callable[[], object], seconds: float, rounds: int = ROUNDS) -> float:
    """Most simulated seconds per second of processor time."""
    best = 0.0
    for _ in range(rounds):
        begin = time.process_time()
        go()
        best = max(best, seconds / (time.process_time() - begin))
    return best


def figures() -> dict[str, dict[str, float]]:
    """Times real time on one core, and largest error in kPa and mm, by way."""
    reference = scipy_run(SHORT_S, 1e-11)

    def error(trace: np.ndarray) -> dict[str, float]:
        off = np.abs(trace[: len(reference)] - reference).max(axis=0)
        return {"error_kpa": float(off[0]) * 1e-3, "error_mm": float(off[1]) * 1e3}

    scene_error = error(scene_run(SHORT_S))
    out: dict[str, dict[str, float]] = {
        "compiled scene": {
            "times_real_time": best_of(lambda: scene_run(LONG_S), LONG_S), **scene_error
        },
        "compiled single bench": {
            "times_real_time": best_of(lambda: bench_run(LONG_S), LONG_S),
            **error(bench_run(SHORT_S)),
        },
    }  # fmt: skip
    # The loosest tolerance of a sweep whose error is no larger than the scene's.
    chosen = 1e-11
    for tolerance in (1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9):
        found = error(scipy_run(SHORT_S, tolerance))
        if all(found[k] <= scene_error[k] for k in found):
            chosen = tolerance
            break
    way = f"SciPy solve_ivp, rtol {chosen:g}"
    out[way] = {
        "times_real_time": best_of(lambda: scipy_run(SHORT_S, chosen), SHORT_S, 2),
        **error(scipy_run(SHORT_S, chosen)),
    }
    loose = "SciPy solve_ivp, rtol 0.001 (its default)"
    out[loose] = {
        "times_real_time": best_of(lambda: scipy_run(SHORT_S, 1e-3), SHORT_S, 2),
        **error(scipy_run(SHORT_S, 1e-3)),
    }
    for integrator in ("Euler", "RK4"):
        go = mujoco_run(LONG_S, integrator)
        out[f"MuJoCo cylinder, {integrator}, 1 ms"] = {"times_real_time": best_of(go, LONG_S, 3)}
    for name, words in (("held-steps", "one muscle"), ("antagonists", "two muscles, one joint")):
        out[f"firmware's Python in the loop, {words}"] = {"times_real_time": firmware_speed(name)}
    bench = Bench(C, "hung")
    out["scheme's step alone in the loop, one muscle"] = {
        "times_real_time": best_of(lambda: run_trial(bench, "burst", (0.4,), 4.0), 4.0, 3)
    }
    return out


def main() -> None:
    """Print the table."""
    found = figures()
    first = found["compiled scene"]["times_real_time"]
    if "--json" in sys.argv:
        print(json.dumps(found, indent=2))
        return
    print(f"Python {platform.python_version()}, {os.cpu_count()} processors, "
          f"load {os.getloadavg()[0]:.1f}; processor time, one core")  # fmt: skip
    print(f"{'':46s} times real time   scene is   error kPa    error mm")
    for name, row in found.items():
        error = f"{row['error_kpa']:11.2g} {row['error_mm']:11.2g}" if "error_kpa" in row else ""
        speed = row["times_real_time"]
        print(f"{name:46s} {speed:15.1f} {first / speed:9.1f}x {error}")
    assert layout.PRESSURE == 1


if __name__ == "__main__":
    main()
