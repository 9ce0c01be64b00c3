"""The rubber tube is a spring along the muscle."""

from __future__ import annotations

from plant.constants import PlantConstants
from plant.effects.arguments import Array, Context, Params, Points, Shape, Values
from plant.effects.effect import Effect, InDiagnosis, InPlant, Parameter, Search
from plant.effects.reference import LENGTH_M, length_of, size_of

STIFFNESS, REST, HARDENING = 41, 42, 43  # N/m, m, 1/m2
_HARDENED_M = 8e-3
"""Stretch at which the cubic term equals the linear one, in the diagnosis's hardening form."""


def spring(length: Array, stiffness: float, rest: float, hardening: float, at: float) -> Array:
    """Force of the tube, zero at `rest`.

        F = k (x + h x^3) / (1 + 3 h x_at^2),   x = L - L_rest

    so that dF/dL at the length `at` is k whatever the hardening. A passive spring beside the braid,
    as in Chou and Hannaford (1996); the cubic term stands for the stiffening of rubber (Klute and
    Hannaford 2000).
    """
    x = length - rest
    stated = at - rest
    return stiffness * (x + hardening * x * x * x) / (1.0 + 3.0 * hardening * stated * stated)


def _slots(values: Values, c: PlantConstants) -> dict[int, float]:
    return {
        STIFFNESS: float(values["stiffness_n_mm"]) * 1e3,
        REST: float(values["rest_mm"]) * 1e-3,
        HARDENING: float(values["hardening_per_mm2"]) * 1e6,
    }


def _add(pull: Array, params: Params, p: Array, length: Array) -> Array:
    if params[STIFFNESS] != 0.0:
        return pull + spring(length, params[STIFFNESS], params[REST], params[HARDENING], LENGTH_M)
    return pull


def _stiffness(bound: float, params: Params, p: float, length: float) -> float:
    x = length - params[REST]
    at = LENGTH_M - params[REST]
    slope = params[STIFFNESS] * (1.0 + 3.0 * params[HARDENING] * x * x)
    return float(bound + abs(slope / (1.0 + 3.0 * params[HARDENING] * at * at)))


def _force(
    points: Points, p: Array, length: Array, base: Array, shape: Shape, context: Context
) -> Array:
    c = context.constants
    hardening = 1.0 / _HARDENED_M**2 if "cubic" in shape else 0.0
    return spring(length, 1e3, shape["rest"] * size_of(c), hardening, length_of(c))


def _rest_of(shape: Shape, context: Context) -> dict[str, float]:
    return {"rest_mm": shape["rest"] * size_of(context.constants) * 1e3}


BLADDER_ELASTICITY = Effect(
    "bladder_elasticity",
    "elasticity",
    "muscle",
    "the rubber tube is a spring along the muscle, whatever the pressure",
    (
        Parameter("stiffness_n_mm", "N/mm", "spring rate at 60 mm", 0, 50),
        Parameter("rest_mm", "mm", "length at which the tube pulls nothing", 10, 2000, 72.5),
        Parameter("hardening_per_mm2", "1/mm2", "cubic over linear term", 0, 0.1, 0.0),
    ),
    "force against pressure at one length, but for its intercept; gas and valve traces",
    ("force_zero", "contraction_limit"),
    "pull the vented muscle over its lengths: a spring follows length, a force zero does not",
    equation="F + k (x + h x^3) / (1 + 3 h x_60^2), x = L - rest",
    source="Chou and Hannaford 1996 (spring); Klute and Hannaford 2000 (hardening rubber)",
    standard="a force sensor tared without the muscle, the vented muscle pulled over its lengths",
    constants=("braid_length_mm", "turns"),
    plant=InPlant(slots=_slots, add=_add, stiffness=_stiffness),
    diagnosis=InDiagnosis(force=_force, at_rest=True),
    search=Search(
        step=0.1,
        sign=1,
        blocks=("force", "load"),
        shapes=({"rest": 0.57}, {"rest": 0.68}, {"rest": 0.82}, {"rest": 0.68, "cubic": 1.0}),
        free={"rest": (0.45, 0.95)},
        plant_shape={"rest": 0.82},
        as_plant=_rest_of,
        settled={"stiffness_n_mm": (0.2, 0.0, 5.0), "rest_mm": (65.0, 45.0, 90.0)},
    ),
)
