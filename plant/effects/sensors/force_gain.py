"""The force sensor has a wrong scale."""

from __future__ import annotations

from plant.effects.arguments import Array, Context, Shape
from plant.effects.effect import EachTrial, Effect, InDiagnosis, InSensors, Parameter, Search
from plant.effects.sensors.linearity import POWERS, linearity
from plant.effects.standards import WEIGHTS


def _linearity(force: Array, amount: float, shape: Shape, context: Context) -> Array:
    return amount / 100.0 * linearity(force, context.full_n, shape.get("power", 0.0))


def _reading(amount: float) -> tuple[float, float]:
    return amount / 100.0, 0.0


FORCE_GAIN = Effect(
    "force_gain",
    "force_sensor",
    "sensor",
    "scale of the force reading",
    (Parameter("percent", "%", "read over true", -30, 30),),
    "the unloaded reading; pressure and length; timing",
    ("pressure_gain", "fibre_stretch", "temperature_stiffening"),
    "dead weights over the range",
    equation="read = true (1 + percent / 100)",
    source="VIM 4.12 (sensitivity)",
    standard="dead weights over the range",
    constants=("braid_length_mm", "turns"),
    calibration="force_gain_percent",
    each_trial=(EachTrial("force gain", 0.3, ("force", "load")),),
    reference=(WEIGHTS, 0.1),
    sensors=InSensors(force=_reading),
    diagnosis=InDiagnosis(force_linearity=_linearity),
    search=Search(
        step=0.5,
        sign=0,
        blocks=("force", "load"),
        shapes=({}, {"power": 1.0}),
        free={"power": POWERS},
    ),
)
