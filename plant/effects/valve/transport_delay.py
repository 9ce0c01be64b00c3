"""Short commands open the valve as well, only later."""

from __future__ import annotations

from plant.constants import PlantConstants
from plant.effects.arguments import Params, Shape, Values
from plant.effects.effect import Effect, InDiagnosis, InPlant, Search
from plant.physics import layout


def _slots(values: Values, c: PlantConstants) -> dict[int, float]:
    return {layout.DELAY_MODE: 1.0}


def _gas(params: Params, amount: float, option: str, shape: Shape) -> None:
    params[layout.DELAY_MODE] = 1.0 if amount > 0.5 else 0.0


TRANSPORT_DELAY = Effect(
    "transport_delay",
    "valve_timing",
    "valve",
    "commands shorter than the on-delay do open the valve, later",
    (),
    "commands longer than the delays",
    ("valve_delay", "pressure_lag"),
    "pulses shorter than the on-delay: an inertial valve ignores them",
    equation="every edge acts after its delay, none is withdrawn",
    source="transport against inertial delay, as in logic simulation (IEEE 1076)",
    standard="none needed: pulses shorter than the on-delay",
    plant=InPlant(slots=_slots),
    diagnosis=InDiagnosis(gas=_gas),
    search=Search(step=1.0, sign=1, blocks=("pressure",)),
)
