"""Fibres of the braid rub on each other; the operator is that of `plant.physics.friction`."""

from __future__ import annotations

import numpy as np

from plant.constants import PlantConstants
from plant.effects.arguments import (
    Array,
    Context,
    Flags,
    Params,
    Points,
    Shape,
    Values,
    Whole,
)
from plant.effects.effect import (
    Effect,
    Growth,
    InDiagnosis,
    InPlant,
    Parameter,
    Search,
    same_numbers,
)
from plant.effects.reference import MIDDLE_PRESSURE_PA
from plant.effects.trials import without_noise_turns
from plant.physics.friction import element_slip
from plant.physics.layout import LENGTH, PRESSURE, SLIP, SLIP_ELEMENTS

FORCE, TRAVEL_PRESSURE, TRAVEL_LENGTH = 34, 35, 36  # N, Pa, m
WITH_PRESSURE = 69  # share that goes with the pressure
_TRAVELS = ((40.0, 0.4), (10.0, 0.1), (120.0, 1.2), (40.0, 0.1), (10.0, 0.5), (60.0, 2.5))
"""Rise of pressure (kPa) and shortening (mm) after which all fibres slip."""
_PRESSED_PA = 2e3
"""Gauge pressure from which fibres rub whose friction does not go with pressure alone."""
_AT_END = 0.1
"""Share of a trial's travel within which it begins at an end of it."""
_PAST_ALL = 2.0
"""Travel after which every element slips, from whatever it was before."""
_NO_SLIP_PA = 1e15
"""Rise of pressure after which the seals of a cylinder slip: only its travel moves them."""


def _slots(values: Values, c: PlantConstants) -> dict[int, float]:
    cylinder = c.actuator == "cylinder"
    return {
        FORCE: float(values["friction_n"]),
        TRAVEL_PRESSURE: _NO_SLIP_PA if cylinder else float(values["travel_kpa"]) * 1e3,
        TRAVEL_LENGTH: float(values["travel_mm"]) * 1e-3,
        WITH_PRESSURE: float(values["pressure_share"]),
    }


def _load(p: Array, share: float) -> Array:
    """Load of the contacts, 1 at 300 kPa: what squeezes a seal is there without pressure too."""
    return np.maximum(1.0 - share + share * p / MIDDLE_PRESSURE_PA, 0.0)


def _transient(
    pull: Array, state: Params, params: Params, p: Array, length: Array, rate: Array
) -> Array:
    """Exact whatever the step, as long as the path between does not turn."""
    if params[FORCE] == 0.0 or (p <= 0.0 and params[TRAVEL_PRESSURE] < _NO_SLIP_PA):
        return pull
    travel = (p - state[PRESSURE]) / params[TRAVEL_PRESSURE]
    travel -= (length - state[LENGTH]) / params[TRAVEL_LENGTH]
    total = 0.0
    for i in range(SLIP_ELEMENTS):
        total += element_slip(state[SLIP + i], travel, i)
    slip = total / SLIP_ELEMENTS
    return pull - params[FORCE] * _load(p, params[WITH_PRESSURE]) * slip


def _slide(state: Params, params: Params, dp: float, dlength: float) -> None:
    if params[FORCE] != 0.0:
        travel = dp / params[TRAVEL_PRESSURE] - dlength / params[TRAVEL_LENGTH]
        for i in range(SLIP_ELEMENTS):
            state[SLIP + i] = element_slip(state[SLIP + i], travel, i)


def _stiffness(bound: float, params: Params, p: float, length: float) -> float:
    if params[FORCE] != 0.0:
        first = params[TRAVEL_LENGTH] * 2.0 ** (1 - SLIP_ELEMENTS)
        load = _load(abs(p), params[WITH_PRESSURE])
        return float(bound + abs(params[FORCE] * load) / first)
    return bound


def _stated(shape: Shape, values: Values, c: PlantConstants) -> Shape:
    return {
        **shape,
        "kpa": float(values["travel_kpa"]),
        "mm": float(values["travel_mm"]),
        "pressure": float(values["pressure_share"]),
    }


def after_a_stroke(first: Whole, travel: Array, held: Flags) -> tuple[Whole, Array]:
    """Paths with one more point before each trial that begins at an end of its travel.

    What stands at an end came there by the stroke before, and its contacts still hold that way.
    Elsewhere nothing tells how it came there, and contacts are at rest, as where `held`, shape
    (trials,), is false.
    """
    begins, ends = first[:-1], first[1:]
    before = np.zeros(len(begins))
    for trial, (a, b) in enumerate(zip(begins.tolist(), ends.tolist(), strict=True)):
        if b - a < 2 or not held[trial]:
            continue
        low, high = float(travel[a:b].min()), float(travel[a:b].max())
        if high - low < _PAST_ALL:
            continue  # noise, or no stroke
        near = _AT_END * (high - low)
        way = float(travel[a] - low < near) - float(high - travel[a] < near)
        before[trial] = way * _PAST_ALL
    at = np.minimum(begins, len(travel) - 1)
    made = np.insert(travel, begins, travel[at] + before)
    return first + np.arange(len(first)), np.ascontiguousarray(made)


def _force(
    points: Points, p: Array, length: Array, base: Array, shape: Shape, context: Context
) -> Array:
    from plant.physics import paths

    seals = context.constants.actuator == "cylinder"
    travel = -length / (shape["mm"] * 1e-3)
    if not seals:
        travel = travel + points.path / (shape["kpa"] * 1e3)
    travel = without_noise_turns(points, travel)
    first = points.first
    before = seals or bool(shape.get("held", 0.0))
    if before:
        # A muscle that begins without pressure begins with fibres at rest.
        begun = p[np.minimum(first[:-1], len(p) - 1)] > _PRESSED_PA
        first, travel = after_a_stroke(first, travel, begun | seals)
    slip = np.zeros(len(travel))
    paths.slip(first, travel, slip)
    if before:
        slip = np.delete(slip, first[:-1])
    # The rows of a table of settled points are no path: only a stated direction tells.
    slip = np.where(points.settled, points.direction, slip)
    if shape["pressure"] == 1.0:
        return -slip * (np.maximum(p, 0.0) / MIDDLE_PRESSURE_PA)
    return -slip * np.where((p > _PRESSED_PA) | seals, _load(p, shape["pressure"]), 0.0)


BRAID_FRICTION = Effect(
    "braid_friction",
    "friction",
    "muscle",
    "rate-independent friction between fibres: up and down differ",
    (
        Parameter("friction_n", "N", "half the loop height at 300 kPa", 0, 100),
        Parameter(
            "travel_kpa", "kPa", "rise of pressure after which all fibres slip", 1, 150, 40.0
        ),
        Parameter("travel_mm", "mm", "shortening after which all fibres slip", 0.01, 5, 0.4),
        Parameter("pressure_share", "", "part that goes with pressure, as at 300 kPa", -1, 2, 1.0),
    ),
    "the mean of up and down; gas and valve traces; anything measured at zero pressure",
    ("viscosity", "creep", "link_friction"),
    "the same loop at two speeds, and with a wait at each point: friction keeps its height",
    equation="F - friction (1 - s + s p / 300 kPa) mean(z_i), "
    "four Maxwell-slip elements driven by p and L",
    source="Iwan 1966; Davis and Caldwell 2006; Vo-Minh et al. 2010",
    standard="none needed: a slow loop of pressure at one length",
    plant=InPlant(slots=_slots, transient=_transient, slide=_slide, stiffness=_stiffness),
    diagnosis=InDiagnosis(force=_force, stated=_stated),
    search=Search(
        step=0.5,
        sign=1,
        blocks=("force", "load"),
        shapes=tuple(
            {"kpa": kpa, "mm": mm, "pressure": pressure}
            for kpa, mm in _TRAVELS
            for pressure in (1.0, 0.0)
        ),
        free={"kpa": (3.0, 300.0), "mm": (0.03, 5.0)},
        plant_misfit=0.15,
        growth=Growth("pressure", "growth_n_kpa", "N/kPa", "pressure_share"),
        either="held",
        as_plant=same_numbers(kpa="travel_kpa", mm="travel_mm"),
        settled={"friction_n": (0.5, 0.0, 20.0)},
    ),
)
