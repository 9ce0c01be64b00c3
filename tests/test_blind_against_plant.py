"""Two implementations that share no code: where both are plain, they must say the same.

Both were written separately from the same contract (docs/reference). Nominal trials agree
within the integrators' errors; every effect in its plainest form has the same sign and, where the
catalogue leaves no shape open, the same size.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

import plant.constants
from blind.physics.bench import Trial, no_effect, nominal
from blind.physics.entries import CATALOGUE, Hidden, draw
from blind.physics.readings import Readings, read_trial
from plant.effects.effects import NONE, Effects
from plant.simulator.readings import Readings as PlantReadings
from plant.simulator.readings import readings
from plant.simulator.simulate import commands, run_commands

END, STEP = 6.0, 0.002
TIMES = np.arange(0.0, END, STEP)
VALVE = [
    (0.1, "inlet", 1.0), (0.15, "inlet", 0.0), (0.6, "outlet", 1.0), (0.64, "outlet", 0.0),
    (1.0, "inlet", 1.0), (1.006, "inlet", 0.0), (2.0, "inlet", 1.0), (2.015, "inlet", 0.0),
    (5.0, "outlet", 1.0), (5.02, "outlet", 0.0),
]  # fmt: skip
# A stage shortens a vented muscle whose outlet is open: it draws air in.
DRAWN = [(1.5, "outlet", 1.0), (3.0, "outlet", 0.0)]
STAIRS = [(0.0, 100.0), (1.5, 500.0), (3.5, 200.0)]
LIFT = [(0.0, 0.0), (1.0, 400.0), (3.0, 200.0)]
STAGE = [(0.0, 56.0), (1.0, 56.0), (2.0, 66.0), (4.0, 56.0), (4.5, 61.0), (6.0, 61.0)]
# Effects for which the catalogue leaves the shape open, so that sizes may differ.
SHAPED = {
    "bladder_elasticity", "contraction_limit", "end_cap", "braid_friction", "creep",
    "temperature_stiffening", "supply_droop",
}  # fmt: skip


def course(corners: list[tuple[float, float]]):
    """Levels held until the next corner, as a piecewise-linear course."""
    t, v = [corners[0][0]], [corners[0][1]]
    for when, level in corners[1:]:
        t += [when - 1e-9, when]
        v += [v[-1], level]
    return np.array([*t, 99.0]), np.array([*v, v[-1]])


def edges(commands: list[tuple[float, str, float]]) -> np.ndarray:
    return np.array([(t, 0 if c == "inlet" else 1, v) for t, c, v in commands])


def on_blind(kind: str, e: np.ndarray) -> Readings:
    trial = {
        "valve": lambda: {"held_mm": 60.0, "edges": edges(VALVE)},
        "held": lambda: {"held_mm": 54.0, "regulator": course(STAIRS)},
        "stage": lambda: {"length": tuple(np.array(STAGE).T), "regulator": course([(0.0, 300.0)])},
        "load": lambda: {"load_kg": 2.0, "regulator": course(LIFT)},
        "drawn": lambda: {"length": tuple(np.array(STAGE).T), "edges": edges(DRAWN)},
    }[kind]()  # fmt: skip
    one = Trial("t", "s", "free", 1, 1, 40, END, temperature_c=40.0, camera_hz=50.0, **trial)
    return read_trial(one, nominal(), e, TIMES, TIMES, TIMES)


def on_plant(kind: str, effects: Effects) -> PlantReadings:
    regulated = [(0.0, "inlet", 1.0)]
    rates = [(a[0], "length_rate_mm_s", (b[1] - a[1]) / (b[0] - a[0])) for a, b in pairwise(STAGE)]
    events, more = {
        "valve": (VALVE, {"length_m": 0.060}),
        "held": ([*regulated, *((t, "regulator_kpa", p) for t, p in STAIRS)],
                 {"length_m": 0.054, "pressure_kpa": 100.0, "source": "regulator"}),
        "stage": ([*regulated, *rates, (0.0, "regulator_kpa", 300.0)],
                  {"length_m": 0.056, "pressure_kpa": 300.0, "source": "regulator"}),
        "load": ([*regulated, *((t, "regulator_kpa", p) for t, p in LIFT)],
                 {"length_m": 0.0735, "mass_kg": 2.0, "load": "isotonic", "source": "regulator"}),
        "drawn": ([*DRAWN, *rates], {"length_m": 0.056}),
    }[kind]  # fmt: skip
    c = plant.constants.nominal()
    traces = run_commands(c, commands(events), END, 1.0 / STEP, effects=effects,
                          temperature_c=40.0, trials=40.0, **more)  # fmt: skip
    return readings(traces, c, effects)


CHANNELS = (("pressure", "pressure_kpa"), ("force", "force_n"), ("length", "length_mm"))
KINDS = ("valve", "held", "stage", "load", "drawn")


@pytest.fixture(scope="module")
def plain():
    return {kind: (on_blind(kind, no_effect()), on_plant(kind, NONE)) for kind in KINDS}


@pytest.mark.parametrize("kind", KINDS)
def test_nominal_trials_agree(kind: str, plain) -> None:
    ours, theirs = plain[kind]
    limits = {"pressure": 0.1, "force": 0.12, "length": 0.05}
    for mine, other in CHANNELS:
        apart = np.abs(getattr(ours, mine) - getattr(theirs, other)[: len(TIMES)]).max()
        assert apart < limits[mine], (kind, mine)


VARIANTS = [(e.id, v) for e in CATALOGUE for v in (e.variants or (None,))]


@pytest.mark.parametrize(("name", "variant"), VARIANTS)
def test_an_effect_means_the_same_on_both(name: str, variant: str | None, plain) -> None:
    entry = next(e for e in CATALOGUE if e.id == name)
    drawn = draw(entry, np.random.default_rng(1), nominal(), 0)
    hidden = Hidden(name, 0, entry.usual, drawn.shape, variant)
    e = no_effect()
    hidden.put(e)
    effects = Effects.from_config({name: dict(hidden.parameters)})
    kind = {"load": "load", "stage": "stage", "camera": "stage"}.get(
        entry.needs, "valve" if entry.stage in ("valve", "chamber") else "held"
    )
    if name == "pressure_lag":
        kind = "valve"
    ours, theirs = on_blind(kind, e), on_plant(kind, effects)
    seen = 0
    for mine, other in CHANNELS:
        a = getattr(ours, mine) - getattr(plain[kind][0], mine)
        b = (getattr(theirs, other) - getattr(plain[kind][1], other))[: len(TIMES)]
        size = float(np.sqrt(np.mean(a * a))), float(np.sqrt(np.mean(b * b)))
        if max(size) < (0.1 if mine == "pressure" else 0.02):
            continue
        seen += 1
        along = float(a @ b) / (np.linalg.norm(a) * np.linalg.norm(b))
        assert along > (0.85 if name in SHAPED else 0.98), mine
        if name not in SHAPED:
            assert size[0] / size[1] == pytest.approx(1.0, abs=0.05), mine
    assert seen
