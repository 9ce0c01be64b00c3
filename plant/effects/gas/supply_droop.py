"""The supply pressure falls while it gives air."""

from __future__ import annotations

import math

from plant.constants import PlantConstants
from plant.effects import pressure_stage as stage
from plant.effects.arguments import Params, Shape, Values
from plant.effects.effect import Effect, InDiagnosis, InPlant, InSensors, Parameter, Search
from plant.physics.layout import INLET_CRITICAL_RATIO

DROOP = 62  # Pa that the supply falls at choked flow
_MOST = 0.45
"""Share of the supply that a droop takes at most."""


def drooped(supply: float, downstream: float, droop: float, critical_ratio: float) -> float:
    """Absolute pressure at the inlet of a source that falls in proportion to the flow it gives.

        P1 = P_s - droop q / q_choked,    q_choked: the flow choked at P_s - droop

    the droop line of a regulator's flow characteristic (ISO 6953-2). With the ellipse of ISO 6358
    this is a quadratic in P1; the result is P_s - droop when choked and P_s without flow. A droop
    beyond 45 % of the supply counts as that much.
    """
    if downstream >= supply:
        return supply
    fall = min(droop, _MOST * supply)
    choked = supply - fall
    if downstream <= critical_ratio * choked:
        return choked
    slope = (fall / choked) ** 2
    bend = slope / (1.0 - critical_ratio) ** 2
    a = 1.0 - slope + bend * critical_ratio * critical_ratio
    b = supply + bend * downstream * critical_ratio
    c = supply * supply + bend * downstream * downstream
    # The smaller root, in the form that does not cancel.
    return c / (b + math.sqrt(max(0.0, b * b - a * c)))


def _slots(values: Values, c: PlantConstants) -> dict[int, float]:
    return {DROOP: float(values["droop_kpa"]) * 1e3}


def _upstream(supply: float, params: Params, absolute: float) -> float:
    if params[DROOP] > 0.0:
        return drooped(supply, absolute, params[DROOP], params[INLET_CRITICAL_RATIO])
    return supply


def _shown(supply: float, inside: float, params: Params, values: Values) -> float:
    return float(values["shown"]) * (supply - _upstream(supply, params, inside))


def _gas(params: Params, amount: float, option: str, shape: Shape) -> None:
    params[stage.DROOP] += amount * 1e3
    params[stage.DROOP_TIME] = shape.get("tau_s", 0.0)
    params[stage.DROOP_BACK] = shape.get("back_s", 0.0)


SUPPLY_DROOP = Effect(
    "supply_droop",
    "flow",
    "valve",
    "supply pressure falls while filling",
    (
        Parameter("droop_kpa", "kPa", "largest fall in the data", 0, 300),
        Parameter("shown", "", "share of the fall that the supply channel shows", 0, 1, 0.0),
    ),
    "venting; all settled points",
    ("flow_area", "critical_ratio", "leak"),
    "a pressure sensor right at the inlet, or fills at half the supply pressure",
    equation="P_1 = P_s - droop q / q_choked at the inlet",
    source="ISO 6953-2 (flow characteristic of a regulator)",
    standard="a second pressure gauge at the inlet",
    constants=("supply_kpa", "inlet_conductance_m3_s_pa"),
    stands_for=("supply_kpa",),
    plant=InPlant(slots=_slots, upstream=_upstream),
    sensors=InSensors(supply=_shown),
    diagnosis=InDiagnosis(gas=_gas, largest_fall=True),
    search=Search(
        step=5.0,
        sign=1,
        blocks=("pressure",),
        shapes=(
            {},
            {"tau_s": 0.03},
            {"tau_s": 0.15},
            {"tau_s": 0.6},
            {"tau_s": 2.5},
            # A regulator that gives way at once and recovers slowly.
            {"tau_s": 0.03, "back_s": 0.3},
        ),
        free={"tau_s": (0.005, 6.0), "back_s": (0.005, 6.0)},
        # The headline is the largest fall in the data, the amount that at choked flow.
        bounded=False,
        one_shape=True,
    ),
)
