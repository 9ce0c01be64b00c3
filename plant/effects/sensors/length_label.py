"""The muscle is held at another length than is written down."""

from __future__ import annotations

import numpy as np

from plant.effects.arguments import Array, Points, Shape
from plant.effects.effect import EachTrial, Effect, InDiagnosis, InSensors, Parameter, Search
from plant.effects.standards import HOLDERS

SAME_LABEL_MM = 0.01
"""Labels that differ by less are one label."""


def _held(amount: float) -> float:
    return amount


def _length(points: Points, amount: float, shape: Shape) -> Array:
    off = points.held
    if "only_mm" in shape:  # one label of several is wrong
        off = off & (np.abs(points.length * 1e3 - shape["only_mm"]) < SAME_LABEL_MM)
    return np.where(off, _held(amount) * 1e-3, 0.0)


LENGTH_LABEL = Effect(
    "length_label",
    "length_sensor",
    "sensor",
    "the length at which trials were held is not the one written down",
    (Parameter("offset_mm", "mm", "true minus written", -10, 10),),
    "differences of length; everything within one length",
    ("end_cap",),
    "a gauge block between the holders",
    equation="true length = written + offset",
    source="none needed",
    standard="a gauge block",
    constants=("braid_length_mm", "turns"),
    stands_for=("mountings",),
    each_trial=(EachTrial("held length", 0.02, ("pressure", "force", "camera")),),
    reference=(HOLDERS, 0.05),
    sensors=InSensors(held=_held),
    diagnosis=InDiagnosis(length=_length),
    search=Search(
        step=0.1,
        sign=0,
        blocks=("pressure", "force", "load", "camera"),
        settled={"offset_mm": (0.2, -4.0, 4.0)},
        each_label=True,
    ),
)
