"""The flow chokes at another pressure ratio."""

from __future__ import annotations

from plant.constants import PlantConstants
from plant.effects.arguments import Params, Shape, Values
from plant.effects.effect import Effect, InDiagnosis, InPlant, Parameter, Search, same_numbers
from plant.physics import layout


def _slots(values: Values, c: PlantConstants) -> dict[int, float]:
    ratio = float(values["critical_ratio"])
    index = float(values["index"]) * (c.critical_ratio - ratio)
    return {
        layout.INLET_CRITICAL_RATIO: ratio,
        layout.OUTLET_CRITICAL_RATIO: ratio,
        layout.SUBSONIC_INDEX: index,
    }


def _stated(shape: Shape, values: Values, c: PlantConstants) -> Shape:
    index = float(values["index"])
    return {"index": index} if index else {}


def _gas(params: Params, amount: float, option: str, shape: Shape) -> None:
    if "index" in shape:
        params[layout.SUBSONIC_INDEX] -= shape["index"] * amount
    if "outlet" not in shape:
        params[layout.INLET_CRITICAL_RATIO] += amount
    if "inlet" not in shape:
        params[layout.OUTLET_CRITICAL_RATIO] += amount


CRITICAL_RATIO = Effect(
    "critical_ratio",
    "flow",
    "valve",
    "the flow chokes at another pressure ratio",
    (
        Parameter("critical_ratio", "", "ISO 6358 b", 0.0, 0.9),
        Parameter(
            "index", "", "growth of the subsonic index as b falls, for each 1", 0.0, 3.0, 0.0
        ),
    ),
    "choked flow (filling from low pressure, venting from high); all settled points",
    ("flow_area", "supply_droop"),
    "the last third of a fill and of a vent against the first, supply recorded",
    equation="b -> critical_ratio, m = 0.5 + index (b - critical_ratio), both valves",
    source="ISO 6358-1",
    standard="a flow meter in the line, at several pressure ratios",
    constants=("critical_ratio",),
    neutral="critical_ratio",
    own_constant="critical_ratio",
    plant=InPlant(slots=_slots),
    diagnosis=InDiagnosis(gas=_gas, stated=_stated),
    search=Search(
        step=0.03,
        sign=0,
        blocks=("pressure",),
        # The more passages a valve has in series, the lower b and the higher the index.
        shapes=({}, {"inlet": 1.0}, {"outlet": 1.0}, {"index": 0.4}),
        free={"index": (0.02, 3.0)},
        as_plant=same_numbers(index="index"),
    ),
)
