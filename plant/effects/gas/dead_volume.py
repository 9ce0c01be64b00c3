"""Line and fittings hold more gas than assumed."""

from __future__ import annotations

import math

from plant.constants import PlantConstants
from plant.effects import pressure_stage as stage
from plant.effects.arguments import Params, Shape, Values
from plant.effects.effect import Effect, InDiagnosis, InPlant, Parameter, Search
from plant.effects.standards import SYRINGE
from plant.physics import layout

_STATED_PA = 300e3
"""Gauge pressure at which the extra volume of an elastic hose is stated."""


def _slots(values: Values, c: PlantConstants) -> dict[int, float]:
    return {layout.DEAD_VOLUME: c.dead_volume_m3 + float(values["volume_ml"]) * 1e-6}


def _most(volume_ml: float, soft_pa: float) -> float:
    """What a wall takes up at most, m3, that has taken up a volume at `_STATED_PA`."""
    return volume_ml * 1e-6 / -math.expm1(-_STATED_PA / soft_pa)


def _gas(params: Params, amount: float, option: str, shape: Shape) -> None:
    if "late_kpa" in shape:
        # Any wall that gives way ever less: two exponential laws, and a part that does not widen.
        part = amount / (1.0 + shape["late"] + shape["rigid"])
        _gas(params, part, option, {"soft_kpa": shape["soft_kpa"]})
        _gas(params, part * shape["rigid"], option, {})
        late = shape["late_kpa"] * 1e3
        params[stage.STIFFENING_LATE] += _most(part * shape["late"], late)
        params[stage.STIFFENING_LATE_PA] = late
    elif "elastic" in shape:
        params[stage.ELASTIC] += amount * 1e-6 / _STATED_PA
    elif "soft_kpa" in shape:
        # An exponential law of the wall, as of blood vessels: stated as the linear one.
        soft = shape["soft_kpa"] * 1e3
        params[stage.STIFFENING] += _most(amount, soft)
        params[stage.STIFFENING_PA] = soft
    elif "yields_s" in shape:
        # A viscoelastic wall (Voigt element), as of rubber hoses: stated as the elastic one.
        params[stage.YIELDING] += amount * 1e-6 / _STATED_PA
        params[stage.YIELDING_TIME] = shape["yields_s"]
    elif "line_s" in shape:
        params[stage.LINE] += max(amount, 0.0) * 1e-6
        params[stage.LINE_TIME] = shape["line_s"]
        params[stage.LINE_ORIFICE] = shape.get("orifice", 0.0)
        params[stage.LINE_EMPTIES] = shape.get("empties", 0.0)
    else:
        params[layout.DEAD_VOLUME] += amount * 1e-6


DEAD_VOLUME = Effect(
    "dead_volume",
    "gas",
    "chamber",
    "more volume in line and fittings than assumed",
    (Parameter("volume_ml", "ml", "extra volume", 0, 100),),
    "all settled points; the pressure finally reached",
    ("flow_area", "polytropic", "leak"),
    "fill at a short and a long length: extra volume weighs less when the muscle is large; "
    "seal the muscle and move the length",
    equation="V_0 -> V_0 + volume",
    source="ideal gas in one more vessel",
    standard="the line filled with water and weighed, or a known extra vessel",
    constants=("dead_volume_ml", "inlet_conductance_m3_s_pa", "outlet_conductance_m3_s_pa"),
    own_constant="dead_volume_ml",
    # A chamber fills by conductance over volume.
    shows_as=("flow_area",),
    reference=(SYRINGE, 0.05),
    plant=InPlant(slots=_slots),
    diagnosis=InDiagnosis(gas=_gas),
    search=Search(
        step=0.1,
        sign=1,
        blocks=("pressure",),
        # A vessel beside the line, a hose that widens, at once or by and by, a vessel behind a thin
        # tube, behind a hole (tee, fitting, stop cock) or behind a one-way flow control.
        shapes=(
            {},
            {"elastic": 1.0},
            {"soft_kpa": 180.0},
            {"yields_s": 0.1},
            {"line_s": 0.01},
            {"line_s": 0.06},
            {"line_s": 0.03, "orifice": 1.0},
            {"line_s": 0.004, "empties": 20.0},
        ),
        free={
            "line_s": (0.001, 0.3),
            "soft_kpa": (20.0, 1500.0),
            "empties": (0.02, 200.0),
            "yields_s": (0.01, 5.0),
            "late_kpa": (100.0, 3000.0),
            "late": (0.01, 100.0),
            "rigid": (0.01, 100.0),
        },
        curve={"soft_kpa": 90.0, "late_kpa": 400.0, "late": 0.5, "rigid": 0.5},
    ),
)
