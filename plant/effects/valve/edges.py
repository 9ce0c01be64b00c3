"""The four edges that have a delay of their own."""

from __future__ import annotations

from plant.constants import PlantConstants
from plant.effects.effect import Parameter

EDGES = ("inlet_on", "inlet_off", "outlet_on", "outlet_off")
"""In the order of `plant.physics.layout.DELAY`."""
EDGE = Parameter("edge", "", "which of the four delays", choices=EDGES)


def constant_of(c: PlantConstants, edge: str, unit: str) -> float:
    """Nominal delay of an edge in s (`unit` "s") or its slope in s/Pa ("s_per_pa")."""
    return float(getattr(c, f"{edge}_{unit}"))
