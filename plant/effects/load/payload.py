"""The load is not the mass it is said to be."""

from __future__ import annotations

from plant.constants import PlantConstants
from plant.effects.arguments import Array, Params, Points, Shape, Values
from plant.effects.effect import Effect, InDiagnosis, InPlant, Parameter, Search
from plant.effects.reference import length_of
from plant.effects.standards import SCALES

EXTRA = 63  # kg


def _slots(values: Values, c: PlantConstants) -> dict[int, float]:
    return {EXTRA: float(values["mass_kg"])}


def _mass(mass: float, params: Params) -> float:
    return float(mass + params[EXTRA])


def _beside(points: Points, amount: float, shape: Shape, c: PlantConstants) -> Array:
    """What hangs along (a hose, a guide) may weigh more the higher it is lifted."""
    lifted = (length_of(c) - points.length) * 1e3
    return amount * (1.0 + (lifted / shape["lifted_mm"] if "lifted_mm" in shape else 0.0))


PAYLOAD = Effect(
    "payload",
    "load",
    "load",
    "the load is not the mass it is said to be",
    (Parameter("mass_kg", "kg", "extra mass", -10, 10),),
    "isometric tests altogether",
    ("link_friction", "force_zero"),
    "weigh the load; or two added masses that are known",
    equation="m -> m + extra mass",
    source="Newton's second law",
    standard="a balance",
    reference=(SCALES, 0.005),
    plant=InPlant(slots=_slots, mass=_mass),
    diagnosis=InDiagnosis(mass=_beside),
    search=Search(step=0.02, sign=0, blocks=("load",), shapes=({}, {"lifted_mm": 20.0})),
)
