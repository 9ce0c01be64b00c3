"""The pressure gauge follows the pressure late."""

from __future__ import annotations

import numpy as np

from plant.constants import PlantConstants
from plant.effects import pressure_stage as stage
from plant.effects.arguments import Array, Params, Points, Shape, Values
from plant.effects.effect import Effect, InDiagnosis, InPlant, Parameter, Search, same_numbers
from plant.physics.lag import LEAST_PA, STATED_PA, at_pressure, follow
from plant.physics.layout import ATMOSPHERE, LAG_WITH_PRESSURE, PRESSURE, PRESSURE_READ, REMEMBERS
from plant.physics.layout import PRESSURE_LAG as LAG

_OUTSIDE_PA = 101325.0
"""Atmosphere where a lag changes with the absolute pressure; some kPa of it do not matter."""


def _slots(values: Values, c: PlantConstants) -> dict[int, float]:
    lag = float(values["time_ms"]) * 1e-3
    power = float(values["with_pressure"])
    return {LAG: lag, LAG_WITH_PRESSURE: power, REMEMBERS: 1.0} if lag > 0.0 else {}


def _follow(
    state: Params, params: Params, p0: float, pull0: float, pull: float, duration: float
) -> None:
    if params[LAG] > 0.0:
        seen = state[PRESSURE_READ]
        middle = 0.5 * (p0 + state[PRESSURE]) + params[ATMOSPHERE]
        late = at_pressure(params[LAG], params[LAG_WITH_PRESSURE], middle)
        state[PRESSURE_READ] = follow(seen, p0, state[PRESSURE], duration, late)


def _stated(shape: Shape, values: Values, c: PlantConstants) -> Shape:
    power = float(values["with_pressure"])
    return {"with_pressure": power} if power else {}


def _pressure(p: Array, points: Points, amount: float, shape: Shape) -> Array:
    late = amount * 1e-3 * points.pressure_slope
    if "with_pressure" in shape:
        absolute = np.maximum(p + _OUTSIDE_PA, LEAST_PA)
        late = late * (absolute / STATED_PA) ** -shape["with_pressure"]
    return np.asarray(p + late)


def _gas(params: Params, amount: float, option: str, shape: Shape) -> None:
    # A tube before the sensor is a lag of its own; the headline is the two together.
    before = shape.get("before", 0.0)
    params[stage.LAG] += (1.0 - before) * max(amount, 0.0) * 1e-3
    params[stage.LAG_BEFORE] += before * max(amount, 0.0) * 1e-3
    if "with_pressure" in shape:
        params[stage.LAG_WITH_PRESSURE] = shape["with_pressure"]
    if "damping" in shape:  # gas in a tube and before the sensor swings: second order, as late
        params[stage.LAG_DAMPING] = shape["damping"]


PRESSURE_LAG = Effect(
    "pressure_lag",
    "pressure_sensor",
    "sensor",
    "first-order lag of the pressure reading",
    (
        Parameter("time_ms", "ms", "time constant", 0, 1000),
        Parameter("with_pressure", "", "power of absolute pressure that it falls with", 0, 2, 0.0),
    ),
    "all settled points",
    ("viscosity", "valve_delay", "transport_delay", "camera_delay"),
    "pressure against force at constant length: both must start together and do not",
    equation="time (400 kPa / P)^with_pressure d(read)/dt = true - read",
    source="first-order instrument (Doebelin 2003)",
    standard="a fast pressure sensor on the same line",
    plant=InPlant(slots=_slots, follow=_follow),
    diagnosis=InDiagnosis(pressure=_pressure, gas=_gas, stated=_stated),
    search=Search(
        step=2.0,
        sign=1,
        blocks=("pressure", "force", "load"),
        shapes=({}, {"before": 0.3}, {"with_pressure": 0.5}, {"damping": 0.5}),
        free={"before": (0.02, 0.5), "with_pressure": (0.05, 2.0), "damping": (0.1, 1.0)},
        as_plant=same_numbers(with_pressure="with_pressure"),
    ),
)
