"""The liner must swell before it meets the braid.

The formula is `plant.physics.muscle.liner_pressure`, which the static laws use as well.
"""

from __future__ import annotations

import numpy as np

from plant.constants import PlantConstants
from plant.effects.arguments import Array, Params, Shape, Values
from plant.effects.effect import Effect, InDiagnosis, InPlant, Parameter, Search, same_numbers
from plant.physics.muscle import liner_pressure

LOST, WIDTH = 32, 33  # Pa


def _slots(values: Values, c: PlantConstants) -> dict[int, float]:
    return {LOST: float(values["threshold_kpa"]) * 1e3, WIDTH: float(values["width_kpa"]) * 1e3}


def _push(push: Array, params: Params, p: Array) -> Array:
    if params[LOST] > 0.0:
        return liner_pressure(p, params[LOST], params[WIDTH])
    return push


def _lost(p: Array, amount: float, shape: Shape) -> Array:
    lost = amount * 1e3
    if "saturating" in shape:
        knee = max(abs(lost), 1.0) * 1.5
        return lost * (1.0 - np.exp(-np.maximum(p, 0.0) / knee))
    positive = np.maximum(p, 0.0)
    behind = liner_pressure(positive, lost, shape["width_kpa"] * 1e3)
    return np.where(p > 0.0, positive - behind, 0.0)


LINER_THRESHOLD = Effect(
    "liner_threshold",
    "dead_space",
    "muscle",
    "the liner must swell before it meets the braid: little force below a threshold",
    (
        Parameter("threshold_kpa", "kPa", "gauge pressure lost at high pressure", 0, 500),
        Parameter("width_kpa", "kPa", "softness of the knee (softplus width)", 1, 200, 25.0),
    ),
    "force per pressure well above the threshold; gas and valve traces; up against down",
    ("pressure_zero",),
    "vent and read the pressure: a zero shows there, a liner does not; and a liner bends the "
    "force line below the threshold where a zero shifts it whole",
    equation="p -> w ln(1 + exp(-p_t / w) (exp(p / w) - 1)), which tends to p - p_t",
    source="Chou and Hannaford 1996; Klute and Hannaford 2000 (threshold pressure)",
    standard="a vented pressure gauge; force at closely spaced low pressures",
    of_braid=True,
    plant=InPlant(slots=_slots, push=_push),
    diagnosis=InDiagnosis(lost=_lost),
    search=Search(
        step=10.0,
        sign=1,
        blocks=("force", "load"),
        shapes=({"width_kpa": 6.0}, {"width_kpa": 25.0}, {"width_kpa": 60.0}, {"saturating": 1.0}),
        free={"width_kpa": (3.0, 150.0)},
        plant_shape={"width_kpa": 25.0},
        plant_misfit=0.1,
        as_plant=same_numbers(width_kpa="width_kpa"),
        settled={"threshold_kpa": (60.0, 0.0, 300.0), "width_kpa": (25.0, 2.0, 150.0)},
    ),
)
