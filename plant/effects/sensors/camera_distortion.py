"""The lens bends the picture."""

from __future__ import annotations

import numpy as np

from plant.constants import PlantConstants
from plant.effects.arguments import Array, Shape, Values
from plant.effects.effect import Effect, InDiagnosis, InSensors, Parameter, Search
from plant.effects.reference import middle_of
from plant.effects.standards import BLOCK
from plant.errors import PlantError

_POWER = 3.0


def bend(share: Array, power: float) -> Array:
    """Distortion over that at the end of the range, at this share of the way to the end.

    Radial distortion of the third order (Brown 1966) for a power of three.
    """
    if power == _POWER:
        return share * share * share  # a general power takes ten times as long
    return np.sign(share) * np.abs(share) ** power


def _camera(length: Array, values: Values, c: PlantConstants) -> Array:
    low, high = c.length_min_m * 1e3, c.length_max_m * 1e3
    centre = middle_of(c) * 1e3 + float(values["centre_mm"])
    if not low - 1e-9 <= centre <= high - 0.1 * (high - low):
        raise PlantError(
            f"effect 'camera_distortion': centre_mm puts its centre at {centre:g} mm; it must "
            f"lie within {low:g} to {high - 0.1 * (high - low):g} mm"
        )
    share = (length * 1e3 - centre) / (high - centre)
    return float(values["distortion_mm"]) * 1e-3 * bend(share, _POWER)


def _shape_error(length: Array, amount: float, shape: Shape, c: PlantConstants) -> Array:
    half = 0.5 * (c.length_max_m - c.length_min_m)
    if "edge" in shape:
        share = (length - c.length_min_m) / (2.0 * half)
    else:
        share = (length - middle_of(c)) / half
    power = shape.get("power", _POWER)
    return amount * 1e-3 * bend(np.abs(share) if "even" in shape else share, power)


CAMERA_DISTORTION = Effect(
    "camera_distortion",
    "length_sensor",
    "sensor",
    "lens distortion is not taken out",
    (
        Parameter("distortion_mm", "mm", "at the end of the range", -5, 5),
        Parameter("centre_mm", "mm", "of no distortion, from mid-range", -10, 10, 0.0),
    ),
    "the middle of the picture; isometric tests by label",
    ("end_cap", "camera_scale", "contraction_limit"),
    "one gauge block moved across the picture",
    equation="read = true + distortion ((true - centre) / (length_max - centre))^3",
    source="Brown 1966 (third-order radial distortion)",
    standard="one gauge block moved across the picture",
    reference=(BLOCK, 0.02),
    sensors=InSensors(camera=_camera),
    diagnosis=InDiagnosis(camera=_shape_error, camera_bends=True),
    search=Search(
        step=0.1,
        sign=0,
        blocks=("pressure", "force", "load", "camera"),
        shapes=({"power": 3.0}, {"power": 2.0, "even": 1.0}, {"power": 3.0, "edge": 1.0}),
        free={"power": (1.5, 6.0)},
        fixed_by=("even",),
    ),
)
