"""A delay of a valve differs by a constant."""

from __future__ import annotations

from plant.constants import PlantConstants
from plant.effects.effect import EachTrial, Effect, Parameter, Search
from plant.effects.valve.edges import EDGE, EDGES, added
from plant.physics import layout


def _late(amount: float, c: PlantConstants) -> float:
    return abs(amount) * 1e-3


_IN_PLANT, _IN_DIAGNOSIS = added(layout.DELAY, "delay_ms", "s", 1e-3, _late)

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
    own_constant="{option}_ms",
    each_trial=(
        EachTrial("inlet timing", 0.03, ("pressure",), "inlet_on"),
        EachTrial("outlet timing", 0.03, ("pressure",), "outlet_on"),
    ),
    plant=_IN_PLANT,
    diagnosis=_IN_DIAGNOSIS,
    search=Search(step=0.3, sign=0, blocks=("pressure",), scan="delay"),
)
