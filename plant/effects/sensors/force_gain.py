"""The force sensor has a wrong scale."""

from __future__ import annotations

from plant.effects.arguments import Array, Context, Shape
from plant.effects.effect import EachTrial, Effect, InDiagnosis, InSensors, Search
from plant.effects.sensors.linearity import CALIBRATION_CURVE, FREE, SHAPES, Scale, linearity
from plant.effects.standards import WEIGHTS

_SCALE = Scale("N", 1.0, 50.0)


def _linearity(force: Array, amount: float, shape: Shape, context: Context) -> Array:
    return amount / 100.0 * linearity(force, context.full_n, shape)


def _as_plant(shape: Shape, context: Context) -> dict[str, float]:
    return _SCALE.as_parameters(shape, context.full_n)


def _reading(amount: float) -> tuple[float, float]:
    return amount / 100.0, 0.0


FORCE_GAIN = Effect(
    "force_gain",
    "force_sensor",
    "sensor",
    "scale of the force reading",
    _SCALE.parameters,
    "the unloaded reading; pressure and length; timing",
    ("pressure_gain", "fibre_stretch", "temperature_stiffening"),
    "dead weights over the range",
    equation="read = true (1 + percent / 100 c(true / full)), c = 1 on a straight scale",
    source="VIM 4.12 (sensitivity)",
    standard="dead weights over the range",
    constants=("braid_length_mm", "turns"),
    calibration="force_gain_percent",
    each_trial=(EachTrial("force gain", 0.3, ("force", "load")),),
    reference=(WEIGHTS, 0.1),
    sensors=InSensors(force=_reading, force_bent=_SCALE.bent, scale_changes=_SCALE.changes),
    diagnosis=InDiagnosis(force_linearity=_linearity, stated=_SCALE.stated),
    search=Search(
        step=0.5,
        sign=0,
        blocks=("force", "load"),
        shapes=SHAPES,
        free=FREE,
        curve=CALIBRATION_CURVE,
        as_plant=_as_plant,
    ),
)
