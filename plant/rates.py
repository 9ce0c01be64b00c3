"""What acts on gas and load at one instant, in compiled code: forces, flows, time constants.

`state` and `params` are the arrays of `plant.layout`; pressures are gauge unless called absolute.
"""

from __future__ import annotations

import math

from plant import flow, muscle
from plant import layout as at
from plant.compiled import Slots, inlined
from plant.constants import (
    GAS_CONSTANT_J_KG_K,
    REFERENCE_DENSITY_KG_M3,
    REFERENCE_TEMPERATURE_K,
)
from plant.friction import REFERENCE_PRESSURE_PA, element_slip

_factor = inlined(flow.subsonic_factor)
_factor_slope = inlined(flow.subsonic_slope)
_force = inlined(muscle.braid_force)
_force_slope = inlined(muscle.braid_force_slope)
_volume = inlined(muscle.braid_volume)
_volume_slope = inlined(muscle.braid_volume_slope)
_liner = inlined(muscle.liner_pressure)
element = inlined(element_slip)


@inlined
def tension(params: Slots, p: float, length: float, slip: float) -> float:
    """Force of the muscle in N; `slip` is the mean slip of the friction elements."""
    push = p
    if params[at.LINER_LOST] > 0.0:
        push = _liner(p, params[at.LINER_LOST], params[at.LINER_WIDTH])
    pull = _force(push, length, params[at.BRAID_LENGTH], params[at.TURNS])
    if params[at.FRICTION_FORCE] != 0.0 and p > 0.0:
        pull -= params[at.FRICTION_FORCE] * p / REFERENCE_PRESSURE_PA * slip
    return pull


@inlined
def slip_after(state: Slots, params: Slots, dp: float, dlength: float) -> float:
    """Mean slip after a further change of pressure and length; `state` is left alone.

    Exact whatever the step, as long as the path between does not turn.
    """
    if params[at.FRICTION_FORCE] == 0.0:
        return 0.0
    travel = dp / params[at.FRICTION_TRAVEL_PRESSURE] - dlength / params[at.FRICTION_TRAVEL_LENGTH]
    total = 0.0
    for i in range(at.SLIP_ELEMENTS):
        total += element(state[at.SLIP + i], travel, i)
    return total / at.SLIP_ELEMENTS


@inlined
def chamber(params: Slots, length: float) -> float:
    """Gas volume of muscle, line and fittings, m3."""
    return _volume(length, params[at.BRAID_LENGTH], params[at.TURNS]) + params[at.DEAD_VOLUME]


@inlined
def power(volume: float, exponent: float) -> float:
    """V^k, cheap when isothermal."""
    return volume if exponent == 1.0 else volume**exponent


@inlined
def regulated(state: Slots, params: Slots) -> bool:
    """Whether the regulator sets the pressure now."""
    return params[at.SOURCE] == 1.0 and state[at.INLET_OPEN] > 0.0 and state[at.OUTLET_OPEN] == 0.0


@inlined
def lagged(state: Slots, params: Slots, p0: float, after: float) -> float:
    """Pressure `after` seconds behind the regulator's lag."""
    target = state[at.REGULATOR_SET]
    return target + (p0 - target) * math.exp(-after / params[at.REGULATOR_LAG])


@inlined
def sealed(state: Slots, params: Slots) -> bool:
    """Whether the gas has no way in or out."""
    return (
        state[at.INLET_OPEN] == 0.0
        and state[at.OUTLET_OPEN] == 0.0
        and params[at.LEAK_CONDUCTANCE] == 0.0
    )


@inlined
def outward(state: Slots, params: Slots) -> float:
    """Conductance of every way from the muscle to the atmosphere, without a valve that is shut."""
    return params[at.OUTLET_CONDUCTANCE] * state[at.OUTLET_OPEN] + params[at.LEAK_CONDUCTANCE]


@inlined
def flows(state: Slots, params: Slots, absolute: float) -> tuple[float, float]:
    """Mass flow in and out in kg/s at absolute pressure `absolute` in the muscle."""
    scale = REFERENCE_DENSITY_KG_M3 * math.sqrt(
        REFERENCE_TEMPERATURE_K / params[at.GAS_TEMPERATURE]
    )
    flow_in = 0.0
    flow_out = 0.0
    if state[at.INLET_OPEN] > 0.0:
        supply = state[at.SUPPLY] + params[at.ATMOSPHERE]
        psi = _factor(absolute / supply, params[at.INLET_CRITICAL_RATIO])
        flow_in = scale * params[at.INLET_CONDUCTANCE] * supply * psi
    conductance = outward(state, params)
    if conductance > 0.0:
        psi = _factor(params[at.ATMOSPHERE] / absolute, params[at.OUTLET_CRITICAL_RATIO])
        flow_out = scale * conductance * absolute * psi
    return flow_in, flow_out


@inlined
def fastest_gas(state: Slots, params: Slots, absolute: float, volume: float) -> float:
    """Rate in 1/s of the gas: how fast it runs to equilibrium, or leaves it.

    The second part is for a way that begins at equal pressure, where the ellipse is steep: the
    step must follow the pressure difference as another way builds it up.
    """
    heat = params[at.EXPONENT] * GAS_CONSTANT_J_KG_K * params[at.GAS_TEMPERATURE] / volume
    flow_in, flow_out = flows(state, params, absolute)
    change = heat * abs(flow_in - flow_out)
    slope = 0.0
    leaving = 0.0
    if state[at.INLET_OPEN] > 0.0:
        supply = state[at.SUPPLY] + params[at.ATMOSPHERE]
        critical = params[at.INLET_CRITICAL_RATIO]
        slope += params[at.INLET_CONDUCTANCE] * _factor_slope(absolute / supply, critical)
        leaving = change / (abs(supply - absolute) + flow.LINEAR_BELOW * supply)
    conductance = outward(state, params)
    if conductance > 0.0:
        atmosphere = params[at.ATMOSPHERE]
        critical = params[at.OUTLET_CRITICAL_RATIO]
        ratio = atmosphere / absolute
        slope += conductance * (_factor(ratio, critical) + ratio * _factor_slope(ratio, critical))
        gap = abs(absolute - atmosphere) + flow.LINEAR_BELOW * atmosphere
        leaving = max(leaving, change / gap)
    return max(slope * REFERENCE_DENSITY_KG_M3 * heat, 0.5 * leaving)


@inlined
def fastest_load(state: Slots, params: Slots, absolute: float, volume: float, stop: bool) -> float:
    """Highest angular frequency of the hung mass on muscle, gas and stop, 1/s."""
    length = state[at.LENGTH]
    area = _volume_slope(length, params[at.BRAID_LENGTH], params[at.TURNS])
    stiffness = abs(_force_slope(state[at.PRESSURE], length, params[at.TURNS]))
    stiffness += params[at.EXPONENT] * absolute * area * area / volume
    damping = params[at.LOAD_DAMPING]
    if params[at.FRICTION_FORCE] != 0.0:
        first = params[at.FRICTION_TRAVEL_LENGTH] * 2.0 ** (1 - at.SLIP_ELEMENTS)
        limit = params[at.FRICTION_FORCE] * abs(state[at.PRESSURE]) / REFERENCE_PRESSURE_PA
        stiffness += abs(limit) / first
    if stop:
        stiffness += params[at.STOP_STIFFNESS]
        damping += params[at.STOP_DAMPING]
    return math.sqrt(stiffness / params[at.MASS]) + damping / params[at.MASS]


@inlined
def stop_push(params: Slots, touched: int, length: float, rate: float) -> float:
    """Force of the stop on the load in N, positive downwards; a stop pushes and never pulls."""
    if touched == 0:
        return 0.0
    if touched < 0:
        push = params[at.STOP_STIFFNESS] * (params[at.LENGTH_MIN] - length)
        return max(0.0, push - params[at.STOP_DAMPING] * rate)
    push = params[at.STOP_STIFFNESS] * (length - params[at.LENGTH_MAX])
    return -max(0.0, push + params[at.STOP_DAMPING] * rate)
