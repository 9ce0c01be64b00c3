"""A valve passes more or less than its data sheet says."""

from __future__ import annotations

from plant.constants import PlantConstants
from plant.effects import pressure_stage as stage
from plant.effects.arguments import Params, Shape, Values
from plant.effects.effect import Effect, InDiagnosis, InPlant, Parameter, Search
from plant.physics import layout

_LEAST = 0.02
"""Share of the nominal conductance below which the diagnosis does not go."""


def _slots(values: Values, c: PlantConstants) -> dict[int, float]:
    ratio = float(values["ratio"])
    if values["side"] == "inlet":
        return {layout.INLET_CONDUCTANCE: ratio * c.inlet_conductance_m3_s_pa}
    return {layout.OUTLET_CONDUCTANCE: ratio * c.outlet_conductance_m3_s_pa}


def _gas(params: Params, amount: float, option: str, shape: Shape) -> None:
    inlet = option == "inlet"
    if "drop" in shape:
        params[stage.INLET_DROP if inlet else stage.OUTLET_DROP] += amount
    else:
        side = layout.INLET_CONDUCTANCE if inlet else layout.OUTLET_CONDUCTANCE
        params[side] *= max(1.0 + amount, _LEAST)


FLOW_AREA = Effect(
    "flow_area",
    "flow",
    "valve",
    "inlet or outlet conductance differs from the assumed one",
    (
        Parameter("ratio", "", "conductance over nominal", 0.1, 10),
        Parameter("side", "", "which valve", choices=("inlet", "outlet")),
    ),
    "all settled points; the other side's traces; pulses too short to open",
    ("dead_volume", "polytropic", "critical_ratio", "supply_droop", "leak", "valve_delay"),
    "fill against vent: an area concerns one of them, a volume both; pulses of several "
    "widths: an area scales each, a delay takes the same from each",
    equation="C -> ratio C on one side",
    source="ISO 6358-1",
    standard="a flow meter in the line",
    constants=("inlet_conductance_m3_s_pa", "outlet_conductance_m3_s_pa"),
    neutral=1.0,
    own_constant="{option}_conductance_m3_s_pa",
    ratio=True,
    plant=InPlant(slots=_slots),
    diagnosis=InDiagnosis(gas=_gas),
    search=Search(
        step=0.03,
        sign=0,
        blocks=("pressure",),
        # A seat that lifts, or a filter that throttles, changes with the pressure drop.
        shapes=({}, {"drop": 1.0}),
    ),
)
