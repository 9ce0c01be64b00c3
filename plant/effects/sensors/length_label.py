"""The muscle is held at another length than is written down."""

from __future__ import annotations

import numpy as np

from plant.constants import PlantConstants
from plant.effects.arguments import Array, Context, Points, Shape, Values
from plant.effects.effect import EachTrial, Effect, InDiagnosis, InSensors, Parameter, Search
from plant.effects.reference import middle_of
from plant.effects.standards import HOLDERS

SAME_LABEL_MM = 0.01
"""Labels that differ by less are one label."""


_ENDS = ("short", "long")
"""Error at the shortest and at the longest length over that in the middle of the range."""


def _share(length: Array, shape: Shape, c: PlantConstants) -> Array:
    """Error of a label over that in the middle: a parabola through the middle and both ends.

    A carriage that tilts makes an error that is straight or bowed in its way (ISO 230-2).
    """
    short, long = (shape.get(key, 1.0) for key in _ENDS)
    x = (length - middle_of(c)) / (0.5 * (c.length_max_m - c.length_min_m))
    return 1.0 + 0.5 * (long - short) * x + (0.5 * (long + short) - 1.0) * x * x


def _held(length: Array, values: Values, c: PlantConstants) -> Array:
    shape = {key: float(values[key]) for key in _ENDS}
    return float(values["offset_mm"]) * 1e-3 * _share(length, shape, c)


def _changes(values: Values) -> bool:
    return any(float(values[key]) != 1.0 for key in _ENDS)


def _length(points: Points, amount: float, shape: Shape, c: PlantConstants) -> Array:
    off = points.held
    if "only_mm" in shape:  # one label of several is wrong
        off = off & (np.abs(points.length * 1e3 - shape["only_mm"]) < SAME_LABEL_MM)
    return np.where(off, amount * 1e-3 * _share(points.length, shape, c), 0.0)


def _as_plant(shape: Shape, context: Context) -> dict[str, float]:
    return {key: shape[key] for key in _ENDS if key in shape}


def _stated(shape: Shape, values: Values, c: PlantConstants) -> Shape:
    return {key: float(values[key]) for key in _ENDS} if _changes(values) else {}


LENGTH_LABEL = Effect(
    "length_label",
    "length_sensor",
    "sensor",
    "the length at which trials were held is not the one written down",
    (
        Parameter("offset_mm", "mm", "true minus written, in mid-range", -10, 10),
        Parameter("short", "", "offset at the shortest length over that in mid-range", 0, 10, 1.0),
        Parameter("long", "", "offset at the longest length over that in mid-range", 0, 10, 1.0),
    ),
    "differences of length; everything within one length",
    ("end_cap",),
    "a gauge block between the holders",
    equation="true length = written + offset q(written), a parabola q = 1 in mid-range",
    source="ISO 230-2 (positioning errors of a slide)",
    standard="a gauge block",
    constants=("braid_length_mm", "turns"),
    stands_for=("mountings",),
    each_trial=(EachTrial("held length", 0.02, ("pressure", "force", "camera")),),
    reference=(HOLDERS, 0.05),
    sensors=InSensors(held=_held, scale_changes=_changes),
    diagnosis=InDiagnosis(length=_length, stated=_stated),
    search=Search(
        step=0.1,
        sign=0,
        blocks=("pressure", "force", "load", "camera"),
        free=dict.fromkeys(_ENDS, (0.1, 10.0)),
        curve=dict.fromkeys(_ENDS, 1.0),
        as_plant=_as_plant,
        settled={"offset_mm": (0.2, -4.0, 4.0)},
        each_label=True,
    ),
)
