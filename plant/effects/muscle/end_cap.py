"""The ends of the muscle taper."""

from __future__ import annotations

import numpy as np

from plant.constants import PlantConstants
from plant.effects.arguments import Array, Params, Shape, Values
from plant.effects.effect import Effect, InDiagnosis, InPlant, Parameter, Search
from plant.effects.reference import LENGTH_M, length_of, taken_up
from plant.physics.layout import TURNS
from plant.physics.muscle import braid_force_slope

SHARE, REST = 39, 40  # contraction counts 1 + SHARE times; m
_REST_OVER_LONGEST = 1.02
"""Length without contraction over the longest length, where the diagnosis has to guess it."""


def contraction(length: Array, rest: float, at: float) -> Array:
    """Contraction over that at the length `at`: (L_rest - L) / (L_rest - L_at).

    The cylinder that would pull as this muscle with its tapering ends does is shorter in
    proportion, i.e. contraction counts 1 + s times, the factor k of Tondu and Lopez (2000).
    """
    return (rest - length) / (rest - at)


def _slots(values: Values, c: PlantConstants) -> dict[int, float]:
    rest = float(values["rest_mm"]) * 1e-3
    return {SHARE: float(values["shortening_mm"]) * 1e-3 / (rest - LENGTH_M), REST: rest}


def _inner(inner: Array, params: Params, length: Array) -> Array:
    return inner - params[SHARE] * (params[REST] - length)


def _stiffness(bound: float, params: Params, p: float, length: float) -> float:
    if params[SHARE] != 0.0:
        return float(bound + params[SHARE] * abs(braid_force_slope(p, length, params[TURNS])))
    return bound


def _shortened(p: Array, length: Array, amount: float, shape: Shape, c: PlantConstants) -> Array:
    grow, at = shape["grow"], length_of(c)
    if grow < 0.0:
        share = length / at
    else:
        share = np.maximum(contraction(length, _REST_OVER_LONGEST * c.length_max_m, at), 0.0)
        share = share**grow
    if "fill_kpa" in shape:
        # The ends fill as the pressure rises, the k(P) of Tondu and Lopez.
        share = share * taken_up(p, shape["fill_kpa"])
    return np.asarray(amount * 1e-3 * share)


END_CAP = Effect(
    "end_cap",
    "geometry",
    "muscle",
    "the ends are not cylindrical: effective contraction is larger than the measured one",
    (
        Parameter(
            "shortening_mm", "mm", "effective minus measured length at 60 mm, as positive", -5, 15
        ),
        Parameter("rest_mm", "mm", "length without contraction", 60.5, 2000, 72.5),
    ),
    "proportionality of force to pressure at each length; up against down; timing",
    ("camera_distortion", "camera_scale", "length_label", "contraction_limit", "fibre_stretch"),
    "a gauge block before the camera at several places; then the length is known and what "
    "remains belongs to the muscle",
    equation="L -> L - shortening (rest - L) / (rest - 60 mm) in the force, not in the volume",
    source="Tondu and Lopez 2000 (factor k on the contraction)",
    standard="gauge blocks in place of the muscle",
    constants=("braid_length_mm", "turns"),
    of_braid=True,
    plant=InPlant(slots=_slots, inner=_inner, stiffness=_stiffness),
    diagnosis=InDiagnosis(shortened=_shortened),
    search=Search(
        step=0.2,
        sign=1,
        blocks=("force", "load"),
        shapes=(
            {"grow": 0.0},
            {"grow": 1.0},
            {"grow": 2.0},
            {"grow": -1.0},
            {"grow": 0.0, "fill_kpa": 150.0},
            {"grow": 1.0, "fill_kpa": 150.0},
        ),
        free={"fill_kpa": (30.0, 300.0)},
        plant_shape={"grow": 1.0},
        settled={"shortening_mm": (0.5, -5.0, 8.0)},
    ),
)
