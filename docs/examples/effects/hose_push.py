"""The air hose straightens under pressure and pushes along the muscle: an effect in a package."""

from __future__ import annotations

from plant.constants import PlantConstants
from plant.effects.arguments import Array, Context, Params, Points, Shape, Values
from plant.effects.effect import Effect, InDiagnosis, InPlant, Parameter, Search

PER_PA = 75  # N/Pa: the first free slot
MIDDLE_PA = 300e3


def _slots(values: Values, c: PlantConstants) -> dict[int, float]:
    return {PER_PA: float(values["push_n"]) / MIDDLE_PA}


def _add(pull: Array, params: Params, p: Array, length: Array) -> Array:
    return pull - params[PER_PA] * p


def _force(
    points: Points, p: Array, length: Array, base: Array, shape: Shape, context: Context
) -> Array:
    return -p / MIDDLE_PA


HOSE_PUSH = Effect(
    "hose_push",
    "load",
    "muscle",
    "the air hose straightens under pressure and pushes along the muscle",
    (Parameter("push_n", "N", "force at 300 kPa", -20, 20),),
    "the vented muscle; gas and valve traces",
    ("force_gain",),
    "pressures at the shortest length: there the braid pulls nothing, the hose still pushes",
    equation="F - push p / 300 kPa",
    source="a hose as a straight line",
    standard="the muscle replaced by a rod, the hose under pressure",
    plant=InPlant(slots=_slots, add=_add),
    diagnosis=InDiagnosis(force=_force),
    search=Search(
        step=0.5,
        sign=0,
        blocks=("force", "load"),
        settled={"push_n": (0.5, -20.0, 20.0)},
    ),
)
