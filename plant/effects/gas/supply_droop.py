"""The supply pressure falls while it gives air."""

from __future__ import annotations

from plant.constants import PlantConstants
from plant.effects import pressure_stage as stage
from plant.effects.arguments import Params, Shape, Values
from plant.effects.effect import (
    Effect,
    InDiagnosis,
    InPlant,
    InSensors,
    Parameter,
    Search,
    same_numbers,
)
from plant.physics.flow import drooped
from plant.physics.layout import INLET_CRITICAL_RATIO

DROOP = 62  # Pa that the supply falls at choked flow
POWER = 71  # of the flow that the fall grows with


def _slots(values: Values, c: PlantConstants) -> dict[int, float]:
    return {DROOP: float(values["droop_kpa"]) * 1e3, POWER: float(values["power"])}


def _upstream(supply: float, params: Params, absolute: float) -> float:
    if params[DROOP] > 0.0:
        critical = params[INLET_CRITICAL_RATIO]
        return drooped(supply, absolute, params[DROOP], critical, params[POWER])
    return supply


def _shown(supply: float, inside: float, params: Params, values: Values) -> float:
    return float(values["shown"]) * (supply - _upstream(supply, params, inside))


def _gas(params: Params, amount: float, option: str, shape: Shape) -> None:
    params[stage.DROOP] += amount * 1e3
    params[stage.DROOP_TIME] = shape.get("tau_s", 0.0)
    params[stage.DROOP_BACK] = shape.get("back_s", 0.0)
    if "power" in shape:  # of a droop that is stated, whatever is found beside it
        params[stage.DROOP_POWER] = shape["power"]


def _stated(shape: Shape, values: Values, c: PlantConstants) -> Shape:
    power = float(values["power"])
    return {"power": power} if power != 1.0 else {}


SUPPLY_DROOP = Effect(
    "supply_droop",
    "flow",
    "valve",
    "supply pressure falls while filling",
    (
        Parameter("droop_kpa", "kPa", "largest fall in the data", 0, 300),
        Parameter("shown", "", "share of the fall that the supply channel shows", 0, 1, 0.0),
        Parameter("power", "", "power of the flow that the fall grows with", 0.2, 4, 1.0),
    ),
    "venting; all settled points",
    ("flow_area", "critical_ratio", "leak"),
    "a pressure sensor right at the inlet, or fills at half the supply pressure",
    equation="P_1 = P_s - droop (q / q_choked)^power at the inlet",
    source="ISO 6953-2 (flow characteristic of a regulator); Darcy-Weisbach (power 2: a thin line)",
    standard="a second pressure gauge at the inlet",
    constants=("supply_kpa", "inlet_conductance_m3_s_pa"),
    stands_for=("supply_kpa",),
    plant=InPlant(slots=_slots, upstream=_upstream),
    sensors=InSensors(supply=_shown),
    diagnosis=InDiagnosis(gas=_gas, largest_fall=True, stated=_stated),
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
            # A line or fitting, and a regulator that gives way before much flows.
            {"power": 2.0},
            {"power": 0.5},
            {"power": 0.5, "tau_s": 0.01},
        ),
        free={"tau_s": (0.005, 6.0), "back_s": (0.005, 6.0), "power": (0.2, 4.0)},
        as_plant=same_numbers(power="power"),
        # The headline is the largest fall in the data, the amount that at choked flow.
        bounded=False,
        one_shape=True,
    ),
)
