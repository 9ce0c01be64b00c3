"""A delay of a valve differs by a constant."""

from __future__ import annotations

from plant.constants import PlantConstants
from plant.effects.arguments import Params, Shape, Values
from plant.effects.effect import Effect, InDiagnosis, InPlant, Parameter, Search
from plant.effects.valve.edges import EDGE, EDGES, constant_of
from plant.physics import layout


def _slots(values: Values, c: PlantConstants) -> dict[int, float]:
    edge = str(values["edge"])
    delay = constant_of(c, edge, "s") + float(values["delay_ms"]) * 1e-3
    return {layout.DELAY + EDGES.index(edge): delay}


def _gas(params: Params, amount: float, option: str, shape: Shape) -> None:
    params[layout.DELAY + EDGES.index(option)] += amount * 1e-3


VALVE_DELAY = Effect(
    "valve_delay",
    "valve_timing",
    "valve",
    "on or off delays differ by a constant",
    (Parameter("delay_ms", "ms", "extra delay", -10, 50), EDGE),
    "all settled points; the rate of change while a valve is open",
    ("valve_delay_pressure", "transport_delay", "flow_area", "pressure_lag"),
    "pulse widths from below to well above the delay, at one pressure",
    equation="on_ms or off_ms + delay of one edge",
    source="Nominal plant, delay of the valve; Tables D-1 to D-3",
    standard="a fast pressure sensor right at the valve",
    constants=tuple(f"{edge}_ms" for edge in EDGES),
    plant=InPlant(slots=_slots),
    diagnosis=InDiagnosis(gas=_gas),
    search=Search(step=0.3, sign=0, blocks=("pressure",)),
)
