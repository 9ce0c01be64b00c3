"""Effects in force in a prediction, with the functions by which they act."""

from __future__ import annotations

from dataclasses import dataclass

from gap.effects.recording import RECORDING
from plant.effects.arguments import Shape
from plant.effects.catalogue import CATALOGUE
from plant.effects.effect import InDiagnosis, InSensors

Active = list[tuple[str, str, float, Shape]]
"""Effects in force: id, option (side or edge), amount of the headline parameter, shape."""

OF_TRIAL = "trial"
"""Number of a shape: the trial in which alone an effect acts."""

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


_IN_PRESSURE = ("length", "camera", "gas", "pressure_shown", "pressure_linearity")
_ONLY_THERE = ("gas", "gas_in_trial", "pressure_shown", "late", "largest_fall")


def _in_pressure(diagnosis: InDiagnosis) -> bool:
    return any(getattr(diagnosis, name) is not None for name in _IN_PRESSURE)


def _in_forces(diagnosis: InDiagnosis, sensors: InSensors) -> bool:
    others = (name for name in vars(diagnosis) if name not in _ONLY_THERE)
    read = sensors.pressure is not None or sensors.force is not None
    return read or any(getattr(diagnosis, name) not in (None, False) for name in others)


_PRESSURE = {NOMINAL} | {name for name, (on, _) in _HOOKS.items() if _in_pressure(on)}
_FORCES = {NOMINAL} | {name for name, hooks in _HOOKS.items() if _in_forces(*hooks)}


def acting_in(block: str, active: Active) -> Active:
    """Those of the effects in force that have a function which the block's prediction calls."""
    known = _PRESSURE if block == "pressure" else _FORCES
    return [one for one in active if one[0] in known]


def terms(active: Active) -> list[Term]:
    """The effects in force, in their order."""
    return [
        Term(option, amount, shape, *_HOOKS[name])
        for name, option, amount, shape in active
        if name != NOMINAL
    ]
