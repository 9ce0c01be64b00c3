"""The force at the same pressure and length changes with temperature."""

from __future__ import annotations

from typing import Any

import numpy as np

from plant.constants import PlantConstants
from plant.effects.arguments import Array, Context, Params, Points, Shape, Values
from plant.effects.effect import Effect, InDiagnosis, InPlant, Parameter, Search
from plant.effects.reference import FULL_PRESSURE_PA, TEMPERATURE_C, TYPICAL_FORCE_N

PER_K, FROM, FLAT = 49, 50, 51  # change of force per K; K; share that does not grow with p


def _slots(values: Values, c: PlantConstants) -> dict[int, float]:
    return {
        PER_K: float(values["percent_per_k"]) / 100.0,
        FROM: float(values["reference_c"]) + 273.15,
        FLAT: float(values["flat_share"]),
    }


def _scale(
    pull: Array, params: Params, p: Array, length: Array, temperature: Array, trials: Array,
    braid: Any,
) -> Array:  # fmt: skip
    if params[PER_K] == 0.0:
        return pull
    grown = pull
    flat = params[FLAT]
    if flat != 0.0:
        grown = pull + flat * (braid(params, 0.0 * p + FULL_PRESSURE_PA, length) - pull)
    return pull + params[PER_K] * (temperature - params[FROM]) * grown


def _force(
    points: Points, p: Array, length: Array, base: Array, shape: Shape, context: Context
) -> Array:
    warmer = np.nan_to_num(points.temperature - context.room_c) * 0.01
    if "additive" in shape:
        return warmer * np.where(p > 1e3, TYPICAL_FORCE_N, 0.0)
    weight = np.maximum(p, 2e4) / FULL_PRESSURE_PA
    return warmer * base * weight ** shape.get("pressure", 0.0)


def _as_plant(shape: Shape, context: Context) -> dict[str, float]:
    return {"reference_c": context.room_c}


TEMPERATURE_STIFFENING = Effect(
    "temperature_stiffening",
    "temperature",
    "muscle",
    "force at the same pressure and length changes with temperature",
    (
        Parameter("percent_per_k", "%/K", "change of force at 500 kPa", -5, 5),
        Parameter("reference_c", "°C", "temperature of no change", -20, 80, TEMPERATURE_C),
        Parameter("flat_share", "", "part that does not grow with pressure", 0, 1, 0.0),
    ),
    "everything at one temperature; valve timing",
    ("creep", "wear", "force_gain"),
    "the same points hot, cold and hot again: it comes back with the temperature",
    equation="F + k (T - T_ref) ((1 - s) F + s F(500 kPa)), F the braid's",
    source="Equations 4-47 to 4-50 of the thesis: constants of the force linear in temperature",
    standard="a thermometer on the muscle",
    of_braid=True,
    plant=InPlant(slots=_slots, scale=_scale),
    diagnosis=InDiagnosis(force=_force),
    search=Search(
        step=0.1,
        sign=0,
        blocks=("force", "load"),
        shapes=({}, {"pressure": 1.0}, {"pressure": -0.5}, {"additive": 1.0}),
        as_plant=_as_plant,
        settled={"percent_per_k": (0.5, -5.0, 5.0), "flat_share": (0.3, 0.0, 1.0)},
    ),
)
