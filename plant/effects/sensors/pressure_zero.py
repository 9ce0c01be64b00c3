"""The pressure gauge has an offset."""

from __future__ import annotations

from plant.effects import pressure_stage as stage
from plant.effects.arguments import Params, Shape
from plant.effects.effect import EachTrial, Effect, InDiagnosis, InSensors, Parameter, Search
from plant.effects.standards import VENT


def _reading(amount: float) -> tuple[float, float]:
    return 0.0, amount


def _gas(params: Params, amount: float, option: str, shape: Shape) -> None:
    params[stage.ZERO] += amount * 1e3


PRESSURE_ZERO = Effect(
    "pressure_zero",
    "pressure_sensor",
    "sensor",
    "offset of the pressure reading",
    (Parameter("offset_kpa", "kPa", "read minus true", -100, 100),),
    "differences of pressure; timing",
    ("liner_threshold", "force_zero"),
    "vent to the atmosphere and read",
    equation="read = true + offset",
    source="VIM 4.28 (zero error)",
    standard="the atmosphere",
    constants=("atmosphere_kpa",),
    calibration="pressure_zero_kpa",
    each_trial=(EachTrial("pressure zero", 0.3, ("pressure", "force", "load")),),
    reference=(VENT, 0.15),
    sensors=InSensors(pressure=_reading),
    diagnosis=InDiagnosis(gas=_gas),
    search=Search(
        step=1.0,
        sign=0,
        blocks=("pressure", "force", "load"),
        settled={"offset_kpa": (2.0, -60.0, 60.0)},
    ),
)
