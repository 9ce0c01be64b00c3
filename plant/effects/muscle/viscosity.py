"""The force depends on the speed."""

from __future__ import annotations

import numpy as np

from plant.constants import PlantConstants
from plant.effects.arguments import Array, Context, Params, Points, Shape, Values
from plant.effects.effect import Effect, InDiagnosis, InPlant, Parameter, Search, same_numbers
from plant.effects.reference import MIDDLE_PRESSURE_PA

DAMPING, EXPONENT, WITH_PRESSURE = 46, 47, 48  # N s/m at 10 mm/s; share that goes with p
_RATE_M_S = 0.010
"""Speed at which the damping is stated."""
_FLOOR_M_S = 1e-4
"""Speed below which a power law of the speed becomes a straight line."""


def drag(rate: Array, p: Array, damping: float, exponent: float, with_pressure: float) -> Array:
    """Force against the motion, damping times speed at 10 mm/s.

        F = c v ((v^2 + e^2) / (v_0^2 + e^2))^((q - 1) / 2) (1 - s + s p / 300 kPa)

    v_0 = 10 mm/s, e = 0.1 mm/s. q = 1 is the dashpot of Reynolds, Repperger, Phillips and Bandry
    (2003), who also saw it grow with pressure (s); q < 1 saturates as in Hill's law, which Klute,
    Czerniecki and Hannaford (2002) used beside such a muscle.
    """
    pace = rate * rate + _FLOOR_M_S * _FLOOR_M_S
    pace0 = _RATE_M_S * _RATE_M_S + _FLOOR_M_S * _FLOOR_M_S
    bend = (pace / pace0) ** (0.5 * (exponent - 1.0))
    load = 1.0 - with_pressure + with_pressure * np.maximum(p, 0.0) / MIDDLE_PRESSURE_PA
    return damping * rate * bend * load


def _slots(values: Values, c: PlantConstants) -> dict[int, float]:
    return {
        DAMPING: float(values["damping_n_s_mm"]) * 1e3,
        EXPONENT: float(values["exponent"]),
        WITH_PRESSURE: float(values["pressure_share"]),
    }


def _transient(
    pull: Array, state: Params, params: Params, p: Array, length: Array, rate: Array
) -> Array:
    if params[DAMPING] != 0.0:
        return pull + drag(rate, p, params[DAMPING], params[EXPONENT], params[WITH_PRESSURE])
    return pull


def _damping(bound: float, params: Params, p: float, rate: float) -> float:
    if params[DAMPING] == 0.0:
        return bound
    exponent = params[EXPONENT]
    pace = max(abs(rate), _FLOOR_M_S)
    force = drag(pace, p, params[DAMPING], exponent, params[WITH_PRESSURE])
    return float(bound + 1.5 * max(1.0, exponent) * abs(force) / pace)


def _force(
    points: Points, p: Array, length: Array, base: Array, shape: Shape, context: Context
) -> Array:
    rate = np.where(points.held, 0.0, points.rate)
    if "knee_mm_s" in shape:
        knee = shape["knee_mm_s"] * 1e-3
        rate = _RATE_M_S * np.tanh(rate / knee) / np.tanh(_RATE_M_S / knee)
    elif "power" in shape:
        rate = _RATE_M_S * np.sign(rate) * (np.abs(rate) / _RATE_M_S) ** shape["power"]
    return drag(rate, p, 1e3, 1.0, 1.0 if "pressure" in shape else 0.0)


VISCOSITY = Effect(
    "viscosity",
    "rate",
    "muscle",
    "force depends on the speed of contraction",
    (
        Parameter("damping_n_s_mm", "N s/mm", "force per speed at 10 mm/s", 0, 10),
        Parameter("exponent", "", "of force over speed: 1 linear, below 1 saturating", 0.2, 2, 1.0),
        Parameter("pressure_share", "", "part that goes with pressure, as at 300 kPa", 0, 1, 0.0),
    ),
    "all settled points; isometric tests altogether",
    ("braid_friction", "link_friction", "pressure_lag", "camera_delay"),
    "moving-length tests at several speeds: force of friction is the same at all of them",
    equation="F + c v (|v| / 10 mm/s)^(q - 1) (1 - s + s p / 300 kPa), v = dL/dt",
    source="Reynolds et al. 2003 (dashpot); Klute, Czerniecki and Hannaford 2002 (Hill's law)",
    standard="a stage that moves the length at a steady rate",
    constants=("load_damping_n_s_mm",),
    plant=InPlant(slots=_slots, transient=_transient, damping=_damping),
    diagnosis=InDiagnosis(force=_force),
    search=Search(
        step=0.02,
        sign=1,
        blocks=("force", "load"),
        shapes=(
            {},
            {"knee_mm_s": 10.0},
            {"knee_mm_s": 40.0},
            {"power": 0.5},
            {"pressure": 1.0},
            {"pressure": 1.0, "knee_mm_s": 17.0},
        ),
        free={"knee_mm_s": (3.0, 150.0), "power": (0.3, 1.0)},
        as_plant=same_numbers(power="exponent", pressure="pressure_share"),
    ),
)
