"""Air escapes whatever the command."""

from __future__ import annotations

from plant.constants import PlantConstants
from plant.effects import pressure_stage as stage
from plant.effects.arguments import Params, Shape, Values
from plant.effects.effect import Effect, InDiagnosis, InPlant, Parameter, Search
from plant.effects.standards import LOCKED

CONDUCTANCE = 31  # m3/(s Pa)


def _slots(values: Values, c: PlantConstants) -> dict[int, float]:
    return {CONDUCTANCE: float(values["conductance_m3_s_pa"])}


def _outward(conductance: float, params: Params) -> float:
    return float(conductance + params[CONDUCTANCE])


def _gas(params: Params, amount: float, option: str, shape: Shape) -> None:
    params[stage.LEAK_LAMINAR if "laminar" in shape else stage.LEAK] += amount


def _gas_in_trial(params: Params, amount: float, trial: int) -> None:
    params[stage.LEAK_OF_TRIAL + trial] += amount


LEAK = Effect(
    "leak",
    "flow",
    "valve",
    "air escapes whatever the command",
    (Parameter("conductance_m3_s_pa", "m3/(s Pa)", "of the leak", 0, 1e-8),),
    "force at a measured pressure; the vented state",
    ("flow_area", "supply_droop", "dead_volume", "polytropic"),
    "shut both valves on a pressurised muscle and watch",
    equation="m_dot_out + ISO 6358 flow of the leak's own conductance to the atmosphere",
    source="ISO 6358-1",
    standard="none needed: the sealed muscle watched for minutes",
    reference=(LOCKED, 2e-13),
    plant=InPlant(slots=_slots, outward=_outward),
    diagnosis=InDiagnosis(gas=_gas, gas_in_trial=_gas_in_trial),
    search=Search(step=1e-12, sign=1, blocks=("pressure",), shapes=({}, {"laminar": 1.0})),
)
