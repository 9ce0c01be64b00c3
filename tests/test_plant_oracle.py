"""The compiled bench against an independent one: SciPy, its own equations, its own events."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from plant.constants import PlantConstants, nominal
from plant.simulator.bench import BenchSim
from plant.simulator.simulate import Commands, commands, run_commands

B, N, V0, ATM, RT, RHO = 0.0884, 1.855, 0.5e-6, 101_325.0, 287.05 * 293.15, 1.185
BREAK = 0.5


def psi(ratio: float) -> float:
    if ratio <= BREAK:
        return 1.0
    return math.sqrt(max(0.0, 1.0 - ((ratio - BREAK) / (1.0 - BREAK)) ** 2))


def through(conductance: float, up: float, down: float) -> float:
    return conductance * RHO * up * psi(down / up) if up > down else 0.0


def gas_rate(p: float, length: float, speed: float, inlet: bool, outlet: bool) -> float:
    volume = (B**2 * length - length**3) / (4 * math.pi * N**2) + V0
    swell = (B**2 - 3 * length**2) / (4 * math.pi * N**2) * speed
    out = through(1.25e-9, p, ATM) - through(1.25e-9, ATM, p)  # an outlet passes air both ways
    flow = through(1.25e-9, 550e3 + ATM, p) * inlet - out * outlet
    return (RT * flow - p * swell) / volume


def pull(p: float, length: float) -> float:
    return (p - ATM) * (3 * length**2 - B**2) / (4 * math.pi * N**2)


def oracle(
    edges: list[tuple[float, str, int]],
    end: float,
    samples: np.ndarray,
    rates: Callable[[np.ndarray, bool, bool], list[float]],
    start: list[float],
    transport: bool,
    stops: tuple[float, float] | None = None,
) -> np.ndarray:
    """Piecewise solve_ivp; a list of pending valve edges kept in plain Python."""
    y, now = np.array(start), 0.0
    is_open = {"inlet": False, "outlet": False}
    pending: list[tuple[float, str, bool]] = []
    todo = sorted(edges, key=lambda e: e[0])
    out = np.full((len(samples), len(start)), np.nan)
    out[0] = y
    while now < end:
        acts = min((p[0] for p in pending), default=math.inf)
        edge_at = todo[0][0] if todo else math.inf
        until = min(acts, edge_at, end)
        if until > now:
            wanted = samples[(samples > now) & (samples <= until)]
            events = []
            for stop in stops or ():

                def touch(t: float, y: np.ndarray, stop: float = stop) -> float:
                    return float(y[1] - stop)

                touch.terminal = True  # type: ignore[attr-defined]
                events.append(touch)
            while now < until:
                result = solve_ivp(
                    lambda t, y: rates(y, is_open["inlet"], is_open["outlet"]),
                    (now, until),
                    y,
                    method="RK45",
                    rtol=1e-10,
                    atol=1e-10,
                    max_step=2e-4,
                    dense_output=True,
                    events=events or None,
                )
                inside = (samples > now) & (samples <= result.t[-1])
                if inside.any():
                    out[inside] = result.sol(samples[inside]).T
                y, now = result.y[:, -1], float(result.t[-1])
                if result.status == 1:
                    y = y.copy()
                    y[1] += 1e-11 * np.sign(y[2])
            assert len(wanted) == 0 or np.isfinite(out[samples <= until]).all()
        if edge_at <= acts and edge_at <= now:
            _, name, value = todo.pop(0)
            upstream = 550.0 if name == "inlet" else (y[0] - ATM) / 1e3
            delay_ms = {
                ("inlet", 1): 8.70 + 0.00395 * upstream,
                ("inlet", 0): 8.94 - 0.00080 * upstream,
                ("outlet", 1): 9.28 + 0.00174 * upstream,
                ("outlet", 0): 8.82 - 0.00058 * upstream,
            }[name, value]
            own = [p for p in pending if p[1] == name]
            if own and not transport:
                pending = [p for p in pending if p[1] != name]
            else:
                due = max([edge_at + delay_ms / 1e3, *(p[0] for p in own)])
                pending.append((due, name, bool(value)))
        elif acts <= now:
            first = min(pending, key=lambda p: p[0])
            pending.remove(first)
            is_open[first[1]] = first[2]
    return out


def random_edges(rng: np.random.Generator, end: float) -> list[tuple[float, str, int]]:
    edges = []
    for name in ("inlet", "outlet"):
        at = float(rng.uniform(0, 0.02))
        value = 1
        while at < end:
            edges.append((at, name, value))
            at += float(rng.uniform(0.001, 0.025))
            value = 1 - value
    return edges


def as_commands(edges: list[tuple[float, str, int]]) -> Commands:
    return commands([(t, name, float(v)) for t, name, v in edges])  # type: ignore[misc]


def constants(mode: str) -> PlantConstants:
    return nominal().with_overrides({"delay_mode": mode})


@pytest.mark.parametrize("mode", ["inertial", "transport"])
@pytest.mark.parametrize("seed", range(4))
def test_isometric_pressure_agrees_with_scipy_on_random_commands(seed: int, mode: str) -> None:
    rng = np.random.default_rng(seed)
    edges, length = random_edges(rng, 0.3), float(rng.uniform(0.051, 0.072))
    traces = run_commands(constants(mode), as_commands(edges), 0.3, length_m=length)
    reference = oracle(
        edges,
        0.3,
        traces.time_s,
        lambda y, i, o: [gas_rate(y[0], length, 0.0, i, o)],
        [ATM],
        mode == "transport",
    )
    assert np.ptp(traces.pressure_kpa) > 20.0
    assert np.abs(traces.pressure_kpa - (reference[:, 0] - ATM) / 1e3).max() < 0.01


@pytest.mark.parametrize("seed", range(3))
def test_moving_stage_agrees_with_scipy(seed: int) -> None:
    rng = np.random.default_rng(100 + seed)
    edges, speed = random_edges(rng, 0.3), float(rng.uniform(-30, 30))
    rows = as_commands(edges) + commands([(0.0, "length_rate_mm_s", speed)])
    traces = run_commands(constants("transport"), rows, 0.3, length_m=0.061)
    reference = oracle(
        edges,
        0.3,
        traces.time_s,
        lambda y, i, o: [gas_rate(y[0], y[1], speed / 1e3, i, o), speed / 1e3],
        [ATM, 0.061],
        True,
    )
    assert np.abs(traces.length_mm - reference[:, 1] * 1e3).max() < 1e-9
    assert np.abs(traces.pressure_kpa - (reference[:, 0] - ATM) / 1e3).max() < 0.01


@pytest.mark.parametrize(("seed", "mass"), [(0, 0.5), (1, 1.0), (2, 3.0)])
def test_hung_mass_between_stops_agrees_with_scipy(seed: int, mass: float) -> None:
    rng = np.random.default_rng(200 + seed)
    edges = random_edges(rng, 0.25)
    low, high = 0.051, 0.0725

    def rates(y: np.ndarray, inlet: bool, outlet: bool) -> list[float]:
        p, length, speed = y
        push = 0.0
        if length < low:
            push = max(0.0, 20e3 * (low - length) - 20.0 * speed)
        elif length > high:
            push = -max(0.0, 20e3 * (length - high) + 20.0 * speed)
        accelerate = 9.80665 + (push - pull(p, length) - 5.0 * speed) / mass
        return [gas_rate(p, length, speed, inlet, outlet), speed, accelerate]

    traces = run_commands(
        constants("transport"),
        as_commands(edges),
        0.25,
        load="isotonic",
        length_m=0.066,
        mass_kg=mass,
    )
    reference = oracle(
        edges, 0.25, traces.time_s, rates, [ATM, 0.066, 0.0], True, stops=(low, high)
    )
    assert traces.length_mm.max() > 72.5 or mass < 1.0
    assert np.abs(traces.pressure_kpa - (reference[:, 0] - ATM) / 1e3).max() < 0.01
    # Over a stroke of 25 mm with hard stops at both ends.
    assert np.abs(traces.length_mm - reference[:, 1] * 1e3).max() < 2e-3


def test_one_recording_and_the_same_ticks_give_the_same_trace() -> None:
    rng = np.random.default_rng(7)
    bench = BenchSim(nominal())
    edges: list[tuple[float, str, int]] = []
    pressure = [0.0]
    on = {"inlet": False, "outlet": False}
    for k in range(400):
        fill, vent = (float(rng.choice([0.0, 0.3e-3, 1e-3], p=[0.5, 0.1, 0.4])) for _ in "ab")
        for name, width in (("inlet", fill), ("outlet", vent)):
            if on[name] != (width > 0):
                edges.append((k * 1e-3, name, int(width > 0)))
            on[name] = width >= 1e-3
            if 0 < width < 1e-3:
                edges.append((k * 1e-3 + width, name, 0))
        bench.advance(1e-3, fill, vent)
        pressure.append(bench.pressure_kpa)
    traces = run_commands(nominal(), as_commands(edges), 0.4)
    assert np.abs(traces.pressure_kpa - pressure).max() < 1e-6
