"""The braid jams near the shortest length."""

from __future__ import annotations

import numpy as np

from plant.constants import PlantConstants
from plant.effects.arguments import Array, Context, Params, Points, Shape, Values
from plant.effects.effect import Effect, InDiagnosis, InPlant, Parameter, Search, same_numbers
from plant.effects.reference import MIDDLE_PRESSURE_PA
from plant.physics.layout import LENGTH_MIN

FORCE, SCALE = 44, 45  # N, m
_OFFSET_M = 1e-3
"""How far above the shortest length the force is stated."""
_LEAST_M = -3e-3
"""Below this, from where the force is stated, the diagnosis lets the loss grow no further."""


def wall(length: Array, lost: float, shortest: float, scale: float) -> Array:
    """Force lost as the braid jams: lost exp(-(L - L_min - 1 mm) / scale).

    The wall term that Tondu (2012) asks for near the greatest contraction, as an exponential.
    """
    return lost * np.exp(-(length - shortest - _OFFSET_M) / scale)


def _slots(values: Values, c: PlantConstants) -> dict[int, float]:
    return {FORCE: float(values["force_n"]), SCALE: float(values["scale_mm"]) * 1e-3}


def _add(pull: Array, params: Params, p: Array, length: Array) -> Array:
    if params[FORCE] != 0.0:
        return pull - wall(length, params[FORCE], params[LENGTH_MIN], params[SCALE])
    return pull


def _stiffness(bound: float, params: Params, p: float, length: float) -> float:
    if params[FORCE] != 0.0:
        lost = abs(params[FORCE])
        return float(bound + wall(length, lost, params[LENGTH_MIN], params[SCALE]) / params[SCALE])
    return bound


def _force(
    points: Points, p: Array, length: Array, base: Array, shape: Shape, context: Context
) -> Array:
    shortest = context.constants.length_min_m
    if "knee_mm" in shape:
        beyond = (length - shortest) * 1e3 - 1.0
        loss = np.maximum(1.0 - beyond / shape["knee_mm"], 0.0) ** 2
    else:
        least = np.maximum(length, shortest + _OFFSET_M + _LEAST_M)
        loss = wall(least, 1.0, shortest, shape["decay_mm"] * 1e-3)
    return -loss * (np.maximum(p, 0.0) / MIDDLE_PRESSURE_PA if "pressure" in shape else 1.0)


CONTRACTION_LIMIT = Effect(
    "contraction_limit",
    "elasticity",
    "muscle",
    "force falls away near the shortest length beyond what the braid angle gives",
    (
        Parameter("force_n", "N", "force lost at length_min + 1 mm", 0, 200),
        Parameter("scale_mm", "mm", "distance over which the loss falls to 1/e", 0.1, 10, 1.0),
    ),
    "all lengths more than a few millimetres from the shortest; gas and valve traces",
    ("bladder_elasticity", "end_cap", "camera_distortion"),
    "isometric points close together in length near the shortest: this loss is local",
    equation="F - f exp(-(L - length_min - 1 mm) / scale)",
    source="Tondu 2012 (force near the greatest contraction)",
    standard="gauge blocks of lengths near the shortest between the holders, and a force sensor",
    of_braid=True,
    plant=InPlant(slots=_slots, add=_add, stiffness=_stiffness),
    diagnosis=InDiagnosis(force=_force, at_rest=True),
    search=Search(
        step=1.0,
        sign=1,
        blocks=("force", "load"),
        shapes=(
            {"decay_mm": 0.7},
            {"decay_mm": 1.6},
            {"decay_mm": 3.2},
            {"decay_mm": 0.7, "pressure": 1.0},
            {"decay_mm": 1.6, "pressure": 1.0},
            {"decay_mm": 3.2, "pressure": 1.0},
            {"knee_mm": 5.0},
            {"knee_mm": 5.0, "pressure": 1.0},
        ),
        free={"decay_mm": (0.3, 4.0), "knee_mm": (1.5, 10.0)},
        plant_shape={"decay_mm": 1.0},
        as_plant=same_numbers(decay_mm="scale_mm"),
        settled={"force_n": (2.0, 0.0, 60.0), "scale_mm": (1.5, 0.3, 8.0)},
    ),
)
