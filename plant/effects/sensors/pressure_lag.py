"""The pressure gauge follows the pressure late."""

from __future__ import annotations

from plant.constants import PlantConstants
from plant.effects import pressure_stage as stage
from plant.effects.arguments import Array, Params, Points, Shape, Values
from plant.effects.effect import Effect, InDiagnosis, InPlant, Parameter, Search
from plant.physics.lag import follow
from plant.physics.layout import PRESSURE, PRESSURE_READ, REMEMBERS
from plant.physics.layout import PRESSURE_LAG as LAG


def _slots(values: Values, c: PlantConstants) -> dict[int, float]:
    lag = float(values["time_ms"]) * 1e-3
    return {LAG: lag, REMEMBERS: 1.0} if lag > 0.0 else {}


def _follow(
    state: Params, params: Params, p0: float, pull0: float, pull: float, duration: float
) -> None:
    if params[LAG] > 0.0:
        seen = state[PRESSURE_READ]
        state[PRESSURE_READ] = follow(seen, p0, state[PRESSURE], duration, params[LAG])


def _pressure(p: Array, points: Points, amount: float) -> Array:
    return p + amount * 1e-3 * points.pressure_slope


def _gas(params: Params, amount: float, option: str, shape: Shape) -> None:
    # A tube before the sensor is a lag of its own; the headline is the two together.
    before = shape.get("before", 0.0)
    params[stage.LAG] = (1.0 - before) * max(amount, 0.0) * 1e-3
    params[stage.LAG_BEFORE] = before * max(amount, 0.0) * 1e-3


PRESSURE_LAG = Effect(
    "pressure_lag",
    "pressure_sensor",
    "sensor",
    "first-order lag of the pressure reading",
    (Parameter("time_ms", "ms", "time constant", 0, 1000),),
    "all settled points",
    ("viscosity", "valve_delay", "transport_delay", "camera_delay"),
    "pressure against force at constant length: both must start together and do not",
    equation="time d(read)/dt = true - read",
    source="first-order instrument (Doebelin 2003)",
    standard="a fast pressure sensor on the same line",
    plant=InPlant(slots=_slots, follow=_follow),
    diagnosis=InDiagnosis(pressure=_pressure, gas=_gas),
    search=Search(
        step=2.0,
        sign=1,
        blocks=("pressure", "force", "load"),
        shapes=({}, {"before": 0.3}),
        free={"before": (0.02, 0.5)},
    ),
)
