"""The force sensor has an offset, the same in all trials."""

from __future__ import annotations

from plant.effects.effect import EachTrial, Effect, InSensors, Parameter, Search
from plant.effects.standards import WEIGHTS


def _reading(amount: float) -> tuple[float, float]:
    return 0.0, amount


FORCE_ZERO = Effect(
    "force_zero",
    "force_sensor",
    "sensor",
    "offset of the force reading, the same in all trials",
    (Parameter("offset_n", "N", "read minus true", -50, 50),),
    "differences of force; pressure and length; timing",
    ("pressure_zero", "bladder_elasticity", "payload"),
    "slacken the muscle and read; one dead weight",
    equation="read = true + offset, after every tare",
    source="VIM 4.28 (zero error)",
    standard="one dead weight",
    calibration="force_zero_n",
    each_trial=(EachTrial("force zero", 0.2, ("force", "load")),),
    reference=(WEIGHTS, 0.05),
    sensors=InSensors(force=_reading),
    search=Search(
        step=0.2,
        sign=0,
        blocks=("force", "load"),
        settled={"offset_n": (0.5, -25.0, 25.0)},
    ),
)
