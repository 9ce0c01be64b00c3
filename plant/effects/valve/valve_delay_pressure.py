"""A delay of a valve depends on pressure differently."""

from __future__ import annotations

from plant.constants import PlantConstants
from plant.effects.effect import Effect, Parameter, Search
from plant.effects.valve.edges import EDGE, EDGES, added
from plant.physics import layout


def _late(amount: float, c: PlantConstants) -> float:
    return abs(amount) * 1e-3 * (c.supply_pa * 1e-3)


_IN_PLANT, _IN_DIAGNOSIS = added(layout.DELAY_SLOPE, "slope_ms_per_kpa", "s_per_pa", 1e-6, _late)

VALVE_DELAY_PRESSURE = Effect(
    "valve_delay_pressure",
    "valve_timing",
    "valve",
    "the delays depend on pressure differently",
    (Parameter("slope_ms_per_kpa", "ms/kPa", "extra slope", -0.1, 0.1), EDGE),
    "pulses at one pressure, but for a constant; all settled points",
    ("valve_delay",),
    "the same pulse at low and at high pressure",
    equation="on_ms_per_kpa or off_ms_per_kpa + slope of one edge",
    source="Nominal plant, delay of the valve; Tables D-1 to D-3",
    standard="a fast pressure sensor right at the valve",
    constants=tuple(f"{edge}_ms_per_kpa" for edge in EDGES),
    own_constant="{option}_ms_per_kpa",
    plant=_IN_PLANT,
    diagnosis=_IN_DIAGNOSIS,
    search=Search(step=0.001, sign=0, blocks=("pressure",)),
)
