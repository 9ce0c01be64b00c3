"""The threads of the braid lengthen under load."""

from __future__ import annotations

import numpy as np

from plant.constants import PlantConstants
from plant.effects.arguments import Array, Params, Shape, Values
from plant.effects.effect import Effect, InDiagnosis, InPlant, Parameter, Search
from plant.effects.reference import FULL_PRESSURE_PA, LENGTH_M, taken_up

PER_PA = 38  # braid length gained per Pa


def _slots(values: Values, c: PlantConstants) -> dict[int, float]:
    return {PER_PA: float(values["stretch_percent"]) / 100.0 / FULL_PRESSURE_PA}


def _threads(b: Array, params: Params, p: Array) -> Array:
    """Length b (1 + s p), after Davis et al. (2003): threads lengthen with their tension."""
    return b * (1.0 + params[PER_PA] * np.maximum(p, 0.0))


def _stretch(p: Array, length: Array, amount: float, shape: Shape, c: PlantConstants) -> Array:
    if "tension" in shape:
        # Tension of a thread: pressure on the wall, more where the muscle is thick and short.
        b2 = c.braid_length_m**2
        share = p / FULL_PRESSURE_PA * (b2 - length**2) / (b2 - LENGTH_M**2)
    elif "crimp_kpa" in shape:
        # The slack of a weave is taken up: after that the threads give way no more.
        share = taken_up(p, shape["crimp_kpa"])
    else:
        share = (np.maximum(p, 0.0) / FULL_PRESSURE_PA) ** shape["power"]
    return amount * 1e-2 * share


FIBRE_STRETCH = Effect(
    "fibre_stretch",
    "geometry",
    "muscle",
    "the braid threads lengthen under load",
    (Parameter("stretch_percent", "%", "of braid length at 500 kPa", 0, 10),),
    "low pressures; up against down; valve timing",
    ("pressure_gain", "force_gain", "end_cap", "camera_scale"),
    "force against pressure at fixed length curves with stretch and stays straight with a "
    "gain; dead weight on the force sensor",
    equation="b -> b (1 + stretch p / 500 kPa) in the force, not in the volume",
    source="Davis, Tsagarakis, Canderle and Caldwell 2003",
    standard="dead weights on the force sensor, then force against pressure at one length",
    constants=("braid_length_mm", "turns"),
    of_braid=True,
    plant=InPlant(slots=_slots, threads=_threads),
    diagnosis=InDiagnosis(stretch=_stretch),
    search=Search(
        step=0.1,
        sign=1,
        blocks=("force", "load"),
        shapes=({"power": 1.0}, {"power": 0.5}, {"tension": 1.0}, {"crimp_kpa": 150.0}),
        free={"power": (0.3, 2.0), "crimp_kpa": (10.0, 1500.0)},
        settled={"stretch_percent": (0.5, 0.0, 8.0)},
    ),
)
