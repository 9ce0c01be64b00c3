"""The pressure gauge has a wrong scale."""

from __future__ import annotations

from plant.effects import pressure_stage as stage
from plant.effects.arguments import Array, Context, Params, Shape
from plant.effects.effect import EachTrial, Effect, InDiagnosis, InSensors, Search
from plant.effects.sensors.linearity import CALIBRATION_CURVE, FREE, SHAPES, Scale, linearity
from plant.effects.standards import GAUGE

_SCALE = Scale("kPa", 1e3, 500.0)


def _linearity(p: Array, amount: float, shape: Shape, context: Context) -> Array:
    return amount / 100.0 * linearity(p, context.full_pa, shape)


def _as_plant(shape: Shape, context: Context) -> dict[str, float]:
    return _SCALE.as_parameters(shape, context.full_pa)


def _reading(amount: float) -> tuple[float, float]:
    return amount / 100.0, 0.0


def _gas(params: Params, amount: float, option: str, shape: Shape) -> None:
    if not shape:
        params[stage.GAIN] = (1.0 + params[stage.GAIN]) * (1.0 + _reading(amount)[0]) - 1.0


PRESSURE_GAIN = Effect(
    "pressure_gain",
    "pressure_sensor",
    "sensor",
    "scale of the pressure reading",
    _SCALE.parameters,
    "the vented reading; timing",
    ("force_gain", "fibre_stretch"),
    "a reference gauge on the same line at one high pressure",
    equation="read = true (1 + percent / 100 c(true / full)), c = 1 on a straight scale",
    source="VIM 4.12 (sensitivity)",
    standard="a reference pressure gauge",
    constants=("supply_kpa", "braid_length_mm", "turns"),
    stands_for=("supply_kpa",),
    calibration="pressure_gain_percent",
    each_trial=(EachTrial("pressure gain", 0.3, ("pressure", "force", "load")),),
    reference=(GAUGE, 0.15),
    sensors=InSensors(pressure=_reading, pressure_bent=_SCALE.bent, scale_changes=_SCALE.changes),
    diagnosis=InDiagnosis(gas=_gas, pressure_linearity=_linearity, stated=_SCALE.stated),
    search=Search(
        step=0.5,
        sign=0,
        blocks=("pressure", "force", "load"),
        shapes=SHAPES,
        free=FREE,
        curve=CALIBRATION_CURVE,
        as_plant=_as_plant,
    ),
)
