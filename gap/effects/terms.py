"""Effects in force in a prediction, with the functions by which they act."""

from __future__ import annotations

from dataclasses import dataclass

from gap.effects.recording import RECORDING
from plant.effects.arguments import Shape
from plant.effects.catalogue import CATALOGUE
from plant.effects.effect import InDiagnosis, InSensors

Active = list[tuple[str, str, float, Shape]]
"""Effects in force: id, option (side or edge), amount of the headline parameter, shape."""

NOMINAL = "nominal"
"""A number of the nominal plant itself, moved by so many sd: `shape["number"]` says which."""

_NONE = InSensors()
_HOOKS = {
    **{effect.id: (effect.diagnosis, effect.sensors) for effect in CATALOGUE.values()},
    **{defect.id: (defect.diagnosis, _NONE) for defect in RECORDING},
}


@dataclass(frozen=True)
class Term:
    """One effect in force."""

    option: str
    amount: float
    shape: Shape
    diagnosis: InDiagnosis
    sensors: InSensors


def terms(active: Active) -> list[Term]:
    """The effects in force, in their order."""
    return [
        Term(option, amount, shape, *_HOOKS[name])
        for name, option, amount, shape in active
        if name != NOMINAL
    ]
