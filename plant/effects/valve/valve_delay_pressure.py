"""A delay of a valve depends on pressure differently."""

from __future__ import annotations

from plant.constants import PlantConstants
from plant.effects.arguments import Params, Shape, Values
from plant.effects.effect import Effect, InDiagnosis, InPlant, Parameter, Search
from plant.effects.valve.edges import EDGE, EDGES, constant_of
from plant.physics import layout


def _slots(values: Values, c: PlantConstants) -> dict[int, float]:
    edge = str(values["edge"])
    slope = constant_of(c, edge, "s_per_pa") + float(values["slope_ms_per_kpa"]) * 1e-6
    return {layout.DELAY_SLOPE + EDGES.index(edge): slope}


def _gas(params: Params, amount: float, option: str, shape: Shape) -> None:
    params[layout.DELAY_SLOPE + EDGES.index(option)] += amount * 1e-6


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
    plant=InPlant(slots=_slots),
    diagnosis=InDiagnosis(gas=_gas),
    search=Search(step=0.001, sign=0, blocks=("pressure",)),
)
