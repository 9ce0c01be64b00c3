"""The camera's millimetres per pixel are off."""

from __future__ import annotations

from plant.constants import PlantConstants
from plant.effects.arguments import Array, Shape, Values
from plant.effects.effect import EachTrial, Effect, InDiagnosis, InSensors, Parameter, Search
from plant.effects.reference import middle_of
from plant.effects.standards import BLOCK


def error(length: Array, percent: float, still: float) -> Array:
    """Read minus true length in m; `still` is the length that is read right."""
    return percent / 100.0 * (length - still)


def _camera(length: Array, values: Values, c: PlantConstants) -> Array:
    return error(length, float(values["percent"]), float(values["still_mm"]) * 1e-3)


def _shape_error(length: Array, amount: float, shape: Shape, c: PlantConstants) -> Array:
    return error(length, amount, middle_of(c) if "middle" in shape else 0.0)


CAMERA_SCALE = Effect(
    "camera_scale",
    "length_sensor",
    "sensor",
    "millimetres per pixel are off",
    (
        Parameter("percent", "%", "read over true", -20, 20),
        Parameter("still_mm", "mm", "length that is read right", 0, 2000, 0.0),
    ),
    "isometric tests by label; the length that is read right",
    ("end_cap", "camera_distortion", "fibre_stretch"),
    "two gauge blocks of different length before the camera",
    equation="read = still + (true - still) (1 + percent / 100)",
    source="pinhole camera at a wrong distance",
    standard="two gauge blocks before the camera",
    constants=("braid_length_mm", "turns"),
    stands_for=("mountings",),
    calibration="length_gain_percent",
    each_trial=(EachTrial("length gain", 0.05, ("force", "load", "camera")),),
    reference=(BLOCK, 0.05),
    sensors=InSensors(camera=_camera),
    diagnosis=InDiagnosis(camera=_shape_error),
    search=Search(
        step=0.2,
        sign=0,
        blocks=("pressure", "force", "load", "camera"),
        shapes=({}, {"middle": 1.0}),
    ),
)
