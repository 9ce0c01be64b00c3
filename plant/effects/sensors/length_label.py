"""The muscle is held at another length than is written down."""

from __future__ import annotations

import numpy as np

from plant.effects.arguments import Array, Points, Shape
from plant.effects.effect import Effect, InDiagnosis, InSensors, Parameter, Search


def _held(amount: float) -> float:
    return amount


def _length(points: Points, amount: float, shape: Shape) -> Array:
    return np.where(points.held, _held(amount) * 1e-3, 0.0)


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
    sensors=InSensors(held=_held),
    diagnosis=InDiagnosis(length=_length),
    search=Search(step=0.1, sign=0, blocks=("pressure", "force", "load", "camera")),
)
