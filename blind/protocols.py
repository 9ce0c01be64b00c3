"""The tests a set is made of: each returns the course of one slot, to be repeated as trials."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from blind.physics import numbers as n
from blind.physics.bench import Trial

Rng = np.random.Generator
Floats = np.ndarray


@dataclass(frozen=True)
class Habits:
    """How this laboratory works: limits, rates and paces that its protocols share."""

    low_mm: float
    high_mm: float
    top_kpa: float
    slow_hz: float
    force_hz: float
    camera_hz: float
    camera_on_held: bool
    pace: float
    regulator_s: float
    heaviest_kg: float
    odd: bool


def habits(rng: Rng, c: Floats, changed: bool) -> Habits:
    """Draw them; `changed` draws from ranges never used otherwise."""
    stiff = 600.0 * (3.0 * c[n.L_MAX] ** 2 - c[n.BRAID] ** 2) / (4.0 * np.pi * c[n.TURNS] ** 2)
    return Habits(
        low_mm=c[n.L_MIN],
        high_mm=c[n.L_MAX],
        top_kpa=float(rng.choice([400.0, 450.0]) if changed else rng.choice([500.0, 550.0, 600.0])),
        slow_hz=float(rng.choice([8.0, 16.0, 40.0]) if changed else rng.choice([10.0, 20.0, 25.0])),
        force_hz=float(rng.choice([40.0, 100.0]) if changed else 80.0),
        camera_hz=float(rng.choice([25.0, 30.0, 60.0]) if changed else 50.0),
        camera_on_held=bool(rng.random() < 0.6),
        pace=float(rng.uniform(1.3, 1.8) if changed else rng.uniform(0.8, 1.2)),
        regulator_s=float(rng.uniform(0.3, 0.6) if changed else 1.0),
        heaviest_kg=float(min(5.0, 0.35e-3 * stiff / 9.81 * 1.0)),
        odd=changed,
    )


def stairs(levels: Floats, dwell: float, rise: float) -> tuple[Floats, Floats]:
    """A course that holds each level for `dwell` s and takes `rise` s to the next."""
    t, v = [0.0], [float(levels[0])]
    for level in levels[1:]:
        t += [t[-1] + dwell, t[-1] + dwell + rise]
        v += [v[-1], float(level)]
    return np.array([*t, t[-1] + dwell]), np.array([*v, v[-1]])


def held(rng: Rng, h: Habits, short: bool = False) -> float:
    """A length to hold the muscle at, mm."""
    low, high = h.low_mm + 1.0, h.high_mm - 2.0
    top = low + 1.5 if short else high
    return round(float(rng.uniform(low, top)) * 2.0) / 2.0


def course(protocol: str, duration: float, **fields: object) -> Trial:
    """A trial without identity yet."""
    return Trial("", "", protocol, 0, 0, 0, float(duration), **fields)  # type: ignore[arg-type]


def isometric(rng: Rng, h: Habits, short: bool = False) -> Trial:
    """Pressure staircase at a held length."""
    levels = np.linspace(0.0, h.top_kpa, int(rng.integers(5, 9)))
    if h.odd and rng.random() < 0.5:
        levels = rng.permutation(levels)
    t, v = stairs(levels, 3.0 * h.pace, 0.02)
    return course(
        "isometric", t[-1], held_mm=held(rng, h, short), regulator=(t, v),
        regulator_s=h.regulator_s, pressure_hz=h.slow_hz, force_hz=min(10.0, h.slow_hz),
        camera_hz=5.0 if h.camera_on_held else 0.0,
    )  # fmt: skip


def hysteresis(rng: Rng, h: Habits) -> Trial:
    """Pressure up and down slowly, at a held length or under a load."""
    half = float(rng.uniform(12.0, 20.0)) * h.pace
    top = h.top_kpa * float(rng.uniform(0.8, 1.0))
    t = np.array([0.0, 1.0, 1.0 + half, 2.0 + half, 2.0 + 2.0 * half, 3.0 + 2.0 * half])
    v = np.array([0.0, 0.0, top, top, 0.0, 0.0])
    common = {
        "regulator": (t, v), "regulator_s": h.regulator_s, "pressure_hz": h.slow_hz,
        "force_hz": min(10.0, h.slow_hz),
    }  # fmt: skip
    if rng.random() < 0.3:
        mass = round(float(rng.uniform(0.5, h.heaviest_kg)), 1)
        return course("hysteresis", t[-1], load_kg=mass, camera_hz=10.0, **common)
    return course(
        "hysteresis", t[-1], held_mm=held(rng, h), camera_hz=5.0 if h.camera_on_held else 0.0,
        **common,
    )  # fmt: skip


def isobaric(rng: Rng, h: Habits) -> Trial:
    """Length staircase at constant pressure."""
    lengths = np.linspace(h.low_mm + 1.5, h.high_mm - 1.5, int(rng.integers(5, 8)))
    if rng.random() < 0.5:
        lengths = lengths[::-1]
    t, v = stairs(np.concatenate([lengths, lengths[-2::-1]]), 2.5 * h.pace, 1.0)
    p = round(float(rng.uniform(0.25, 1.0)) * h.top_kpa, -1)
    return course(
        "isobaric", t[-1], length=(t, v), regulator=(np.array([0.0, t[-1]]), np.array([p, p])),
        pressure_hz=h.slow_hz, force_hz=min(10.0, h.slow_hz), camera_hz=10.0,
    )  # fmt: skip


def triangle(rng: Rng, h: Habits) -> Trial:
    """Length triangles at constant pressure, each cycle at another speed."""
    speeds = (0.7, 4.0, 25.0) if h.odd else (1.0, 5.0, 15.0, 40.0)
    low = float(rng.uniform(h.low_mm + 1.5, h.low_mm + 5.0))
    high = float(rng.uniform(low + 6.0, min(low + 12.0, h.high_mm - 1.5)))
    t, v = [0.0, 1.0], [low, low]
    for speed in speeds[1:] if rng.random() < 0.5 else speeds:
        for _ in range(1 if speed < 3.0 else 2):
            half = (high - low) / speed
            t += [t[-1] + half, t[-1] + 2.0 * half]
            v += [high, low]
        t.append(t[-1] + 0.5)
        v.append(low)
    p = round(float(rng.uniform(0.2, 1.0)) * h.top_kpa, -1)
    return course(
        "triangle", t[-1], length=(np.array(t), np.array(v)),
        regulator=(np.array([0.0, t[-1]]), np.array([p, p])),
        pressure_hz=100.0, force_hz=h.force_hz, camera_hz=h.camera_hz,
    )  # fmt: skip


def isotonic(rng: Rng, h: Habits) -> Trial:
    """Pressure staircase, up or up and down, under a hanging mass."""
    levels = np.linspace(0.0, h.top_kpa, int(rng.integers(5, 8)))
    if rng.random() < 0.6:
        levels = np.concatenate([levels, levels[-2::-1]])
    t, v = stairs(levels, 3.0 * h.pace, 0.02)
    return course(
        "isotonic", t[-1], load_kg=round(float(rng.uniform(0.4, h.heaviest_kg)), 1),
        regulator=(t, v), regulator_s=h.regulator_s, pressure_hz=h.slow_hz,
        force_hz=min(10.0, h.slow_hz) if rng.random() < 0.5 else 0.0, camera_hz=10.0,
    )  # fmt: skip


def hold(rng: Rng, h: Habits) -> Trial:
    """One step of pressure, held for minutes, then a lower one."""
    long = float(rng.uniform(80.0, 140.0)) * h.pace
    top = h.top_kpa * float(rng.uniform(0.6, 1.0))
    t = np.array([0.0, 3.0, 3.02, 3.0 + long, 3.02 + long, 3.0 + 1.4 * long])
    v = np.array([0.0, 0.0, top, top, 0.4 * top, 0.4 * top])
    return course(
        "hold", t[-1], held_mm=held(rng, h), regulator=(t, v), regulator_s=h.regulator_s,
        pressure_hz=h.slow_hz, force_hz=min(10.0, h.slow_hz),
        camera_hz=2.0 if h.camera_on_held else 0.0,
    )  # fmt: skip


def valve_trial(rng: Rng, h: Habits, protocol: str, edges: list[tuple[float, int, int]],
                duration: float, loaded: bool = False) -> Trial:  # fmt: skip
    """A trial the valve drives, at a held length or under a load."""
    table = np.array(sorted(edges), dtype=float).reshape(-1, 3)
    if loaded:
        mass = round(float(rng.uniform(0.8, h.heaviest_kg)), 1)
        return course(
            protocol, duration, edges=table, load_kg=mass, camera_hz=h.camera_hz,
            force_hz=h.force_hz if rng.random() < 0.5 else 0.0,
        )  # fmt: skip
    return course(
        protocol, duration, edges=table, held_mm=held(rng, h), force_hz=h.force_hz,
        camera_hz=h.camera_hz if h.camera_on_held and rng.random() < 0.3 else 0.0,
    )  # fmt: skip


def step(rng: Rng, h: Habits) -> Trial:
    """Fill in one go, wait, vent in one go."""
    fill = float(rng.choice([0.03, 0.05, 0.08, 0.15, 0.4]))
    vent = float(rng.choice([0.04, 0.1, 0.4]))
    wait = float(rng.uniform(0.5, 1.0)) * h.pace
    edges = [(0.2, 0, 1), (0.2 + fill, 0, 0), (0.2 + fill + wait, 1, 1)]
    edges.append((0.2 + fill + wait + vent, 1, 0))
    duration = 0.2 + fill + wait + vent + 0.4
    return valve_trial(rng, h, "step", edges, duration, rng.random() < 0.25)


def square(rng: Rng, h: Habits, short: bool = False) -> Trial:
    """Trains of fill pulses, then of vent pulses; short ones stay under the on-delay."""
    pulse = float(rng.choice([13.0, 17.0] if h.odd else [11.2, 12.0, 15.0, 20.0])) * 1e-3
    if short or rng.random() < 0.35:
        pulse = float(rng.choice([5.0, 7.0] if h.odd else [4.0, 6.0, 8.0])) * 1e-3
    gap = float(rng.uniform(0.06, 0.12)) * h.pace
    count = int(rng.integers(5, 10))
    edges: list[tuple[float, int, int]] = []
    t = 0.1
    if pulse < 9e-3:  # something to vent later, and something seen in any case
        edges += [(t, 0, 1), (t + 0.02, 0, 0)]
        t += gap
    for _ in range(count):
        edges += [(t, 0, 1), (t + pulse, 0, 0)]
        t += gap
    t += 0.2
    for _ in range(count):
        edges += [(t, 1, 1), (t + pulse, 1, 0)]
        t += gap
    return valve_trial(rng, h, "square", edges, t + 0.3)


def decay(rng: Rng, h: Habits) -> Trial:
    """Fill, lock the air in, and watch it."""
    fill = float(rng.choice([0.05, 0.2, 0.5]))
    trial = valve_trial(
        rng, h, "decay", [(0.2, 0, 1), (0.2 + fill, 0, 0)], float(rng.uniform(15.0, 30.0)) * h.pace
    )
    from dataclasses import replace

    return replace(trial, pressure_hz=100.0, force_hz=10.0, camera_hz=0.0)


PROTOCOLS: dict[str, Callable[[Rng, Habits], Trial]] = {
    "isometric": isometric,
    "hysteresis": hysteresis,
    "isobaric": isobaric,
    "triangle": triangle,
    "isotonic": isotonic,
    "hold": hold,
    "step": step,
    "square": square,
    "decay": decay,
}
# Which protocols an effect needs to be seen at all.
SERVES: dict[str, tuple[str, ...]] = {
    "": ("isometric", "isobaric"),
    "short": ("isometric-short", "isobaric"),
    "cycle": ("hysteresis", "isobaric"),
    "stage": ("triangle", "triangle"),
    "hold": ("hold", "isometric"),
    "warm": ("isometric", "isometric"),
    "valve": ("step", "square", "step"),
    "decay": ("decay", "step"),
    "pulses": ("square-short", "square", "step"),
    "load": ("isotonic", "isotonic"),
    "held": ("isometric", "isometric", "hysteresis"),
    "camera": ("isobaric", "isotonic", "triangle"),
}


def slot(name: str, rng: Rng, h: Habits) -> Trial:
    """A slot by protocol name; `-short` asks for the shortest lengths or pulses."""
    if name == "isometric-short":
        return isometric(rng, h, True)
    if name == "square-short":
        return square(rng, h, True)
    return PROTOCOLS[name](rng, h)
