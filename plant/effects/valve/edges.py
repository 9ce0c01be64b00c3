"""The four edges that have a delay of their own."""

from __future__ import annotations

from collections.abc import Callable

from plant.constants import PlantConstants
from plant.effects.arguments import Params, Shape, Values
from plant.effects.effect import InDiagnosis, InPlant, Parameter

EDGES = ("inlet_on", "inlet_off", "outlet_on", "outlet_off")
"""In the order of `plant.physics.layout.DELAY`."""
EDGE = Parameter("edge", "", "which of the four delays", choices=EDGES)


def added(
    first: int, key: str, unit: str, to_si: float, late: Callable[[float, PlantConstants], float]
) -> tuple[InPlant, InDiagnosis]:
    """How an effect acts that adds to the delay of one edge.

    Args:
        first: slot of the first edge; those of the others follow.
        key: of the headline parameter.
        unit: how the edge's constant goes on: "s" for its delay, "s_per_pa" for the slope.
        to_si: factor of the headline parameter.
        late: see `InDiagnosis`.
    """

    def slots(values: Values, c: PlantConstants) -> dict[int, float]:
        edge = str(values["edge"])
        nominal = float(getattr(c, f"{edge}_{unit}"))
        return {first + EDGES.index(edge): nominal + float(values[key]) * to_si}

    def gas(params: Params, amount: float, option: str, shape: Shape) -> None:
        params[first + EDGES.index(option)] += amount * to_si

    return InPlant(slots=slots), InDiagnosis(gas=gas, late=late)
