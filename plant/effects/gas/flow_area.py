"""A valve passes more or less than its data sheet says."""

from __future__ import annotations

from plant.constants import PlantConstants
from plant.effects import pressure_stage as stage
from plant.effects.arguments import Params, Shape, Values
from plant.effects.effect import Effect, InDiagnosis, InPlant, Parameter, Search, same_numbers
from plant.physics import layout

_LEAST = 0.02
"""Share of the nominal conductance below which the diagnosis does not go."""


def _slots(values: Values, c: PlantConstants) -> dict[int, float]:
    ratio = float(values["ratio"])
    fading = -float(values["with_ratio"]) * (ratio - 1.0) / ratio
    if values["side"] == "inlet":
        nominal = c.inlet_conductance_m3_s_pa
        return {layout.INLET_CONDUCTANCE: ratio * nominal, layout.RATIO: fading}
    nominal = c.outlet_conductance_m3_s_pa
    return {layout.OUTLET_CONDUCTANCE: ratio * nominal, layout.RATIO + 1: fading}


def _stated(shape: Shape, values: Values, c: PlantConstants) -> Shape:
    share = float(values["with_ratio"])
    return {"ratio": share} if share else {}


def _gas(params: Params, amount: float, option: str, shape: Shape) -> None:
    inlet = option == "inlet"
    if "drop" in shape:
        params[stage.INLET_DROP if inlet else stage.OUTLET_DROP] += amount
    else:
        side = layout.INLET_CONDUCTANCE if inlet else layout.OUTLET_CONDUCTANCE
        area = max(1.0 + amount, _LEAST)
        params[side] *= area
        if "ratio" in shape:
            params[layout.RATIO + (not inlet)] -= shape["ratio"] * (area - 1.0) / area


FLOW_AREA = Effect(
    "flow_area",
    "flow",
    "valve",
    "inlet or outlet conductance differs from the assumed one",
    (
        Parameter("ratio", "", "conductance over nominal", 0.1, 10),
        Parameter("side", "", "which valve", choices=("inlet", "outlet")),
        Parameter("with_ratio", "", "share of the change that is gone at P2 = P1", 0.0, 1.0, 0.0),
    ),
    "all settled points; the other side's traces; pulses too short to open",
    ("dead_volume", "polytropic", "critical_ratio", "supply_droop", "leak", "valve_delay"),
    "fill against vent: an area concerns one of them, a volume both; pulses of several "
    "widths: an area scales each, a delay takes the same from each",
    equation="C -> C (1 + (ratio - 1) (1 - with_ratio P_2 / P_1)) on one side",
    source="ISO 6358-1",
    standard="a flow meter in the line",
    constants=("inlet_conductance_m3_s_pa", "outlet_conductance_m3_s_pa"),
    neutral=1.0,
    own_constant="{option}_conductance_m3_s_pa",
    ratio=True,
    plant=InPlant(slots=_slots),
    diagnosis=InDiagnosis(gas=_gas, stated=_stated),
    search=Search(
        step=0.03,
        sign=0,
        blocks=("pressure",),
        # A seat that lifts, or a filter that throttles, changes with the pressure drop; a jet is
        # the narrower the less the ratio of the pressures is below 1.
        shapes=({}, {"drop": 1.0}, {"ratio": 0.5}),
        free={"ratio": (0.05, 0.95)},
        as_plant=same_numbers(ratio="with_ratio"),
    ),
)
