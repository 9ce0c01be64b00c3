"""What acts on gas and load at one instant, in compiled code: forces, flows, time constants.

`state` and `params` are the arrays of `plant.physics.layout`; pressures are gauge unless called
absolute.
"""

from __future__ import annotations

import math

from plant.compiled import Slots, called, inlined
from plant.constants import (
    GAS_CONSTANT_J_KG_K,
    REFERENCE_DENSITY_KG_M3,
    REFERENCE_TEMPERATURE_K,
)
from plant.physics import flow, muscle
from plant.physics import layout as at
from plant.simulator import hooks

LEAST_MASS_KG = 1e-3
"""A payload never takes away more than this leaves."""

_factor = inlined(flow.subsonic_factor)
_factor_slope = inlined(flow.subsonic_slope)
_outward = called(flow.outward_drive)
_with_index = inlined(flow.with_index)
_outward_slope = called(flow.outward_slope)
_force = inlined(muscle.braid_force)
_force_slope = inlined(muscle.braid_force_slope)
_volume = inlined(muscle.braid_volume)
_volume_slope = inlined(muscle.braid_volume_slope)


@inlined
def tension(state: Slots, params: Slots, p: float, length: float, rate: float) -> float:
    """Force of the muscle in N at the end of a step that began as `state` says."""
    if params[at.FORCE_EFFECTS] == 0.0:
        return _force(p, length, params[at.BRAID_LENGTH], params[at.TURNS])
    return _with_effects(state, params, p, length, rate)


@inlined
def _deformed(params: Slots, p: float, length: float) -> float:
    """Force of the braid for the pressure, threads and length that count, N."""
    push = hooks.push(p, params, p)
    threads = hooks.threads(params[at.BRAID_LENGTH], params, p)
    inner = hooks.inner(length, params, length)
    pull: float = _force(push, inner, threads, params[at.TURNS])
    return pull


@called
def lasting(state: Slots, params: Slots, p: float, length: float) -> float:
    """Force in N that would stay if pressure and length did: no friction, speed or creep."""
    pull = _deformed(params, p, length)
    temperature, trials = state[at.TEMPERATURE], state[at.TRIAL]
    pull = hooks.scale(pull, params, p, length, temperature, trials, _deformed)
    return float(hooks.add(pull, params, p, length))


@called
def _with_effects(state: Slots, params: Slots, p: float, length: float, rate: float) -> float:
    pull = lasting(state, params, p, length)
    return float(hooks.transient(pull, state, params, p, length, rate))


@called
def added_stiffness(params: Slots, p: float, length: float) -> float:
    """How steeply effects may change the force with length, N/m; never too little."""
    return float(hooks.stiffness(0.0, params, p, length))


@called
def added_damping(params: Slots, p: float, rate: float) -> float:
    """How steeply effects change the force with speed, N s/m."""
    return float(hooks.damping(0.0, params, p, rate))


@inlined
def carried(params: Slots) -> float:
    """Mass in kg that really hangs on the muscle."""
    return float(max(hooks.mass(params[at.MASS], params), LEAST_MASS_KG))


@inlined
def chamber(params: Slots, length: float) -> float:
    """Gas volume of muscle, line and fittings, m3."""
    return _volume(length, params[at.BRAID_LENGTH], params[at.TURNS]) + params[at.DEAD_VOLUME]


_FALLS_SHUT = 1.0001
"""Ratio to the pressure at which a valve falls shut from which on it has: no step ends on it."""


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
        and hooks.outward(0.0, params) == 0.0
    )


@inlined
def _across(state: Slots, which: int) -> float:
    """Pressure across the inlet (0) or the outlet (1), Pa."""
    pressure = state[at.PRESSURE]
    return state[at.SUPPLY] - pressure if which == 0 else pressure


@inlined
def passing(state: Slots, params: Slots, which: int) -> float:
    """Opening of the inlet (0) or the outlet (1); 0 where too little pressure holds it open."""
    closing = params[at.CLOSING + which]
    if closing > 0.0 and _across(state, which) <= closing * _FALLS_SHUT:
        return 0.0
    return state[at.INLET_OPEN + which]


@inlined
def outward(state: Slots, params: Slots) -> float:
    """Conductance of every way from the muscle to the atmosphere, without a valve that is shut."""
    return float(hooks.outward(params[at.OUTLET_CONDUCTANCE] * passing(state, params, 1), params))


@inlined
def inlet_pressure(state: Slots, params: Slots, absolute: float) -> float:
    """Absolute pressure upstream of the open inlet; `absolute` is that in the muscle."""
    return float(hooks.upstream(state[at.SUPPLY] + params[at.ATMOSPHERE], params, absolute))


@inlined
def flows(state: Slots, params: Slots, absolute: float) -> tuple[float, float]:
    """Mass flow through the inlet and out to the atmosphere, kg/s, at `absolute` in the muscle.

    The second is below zero where the muscle is below the atmosphere and draws air in.
    """
    scale = REFERENCE_DENSITY_KG_M3 * math.sqrt(
        REFERENCE_TEMPERATURE_K / params[at.GAS_TEMPERATURE]
    )
    flow_in = 0.0
    flow_out = 0.0
    inlet = passing(state, params, 0)
    if inlet > 0.0:
        supply = inlet_pressure(state, params, absolute)
        psi = _factor(absolute / supply, params[at.INLET_CRITICAL_RATIO])
        if params[at.SUBSONIC_INDEX] != 0.0:
            psi = _with_index(psi, params[at.SUBSONIC_INDEX])
        psi *= 1.0 + params[at.RATIO] * min(absolute / supply, 1.0)
        flow_in = scale * inlet * params[at.INLET_CONDUCTANCE] * supply * psi
    conductance = outward(state, params)
    if conductance > 0.0:
        share = min(params[at.ATMOSPHERE] / absolute, 1.0)
        valve = params[at.OUTLET_CONDUCTANCE] * passing(state, params, 1)
        conductance += valve * params[at.RATIO + 1] * share
        drive = _outward(absolute, params[at.ATMOSPHERE], params[at.OUTLET_CRITICAL_RATIO])
        if params[at.SUBSONIC_INDEX] != 0.0 and drive > 0.0:
            drive = absolute * _with_index(drive / absolute, params[at.SUBSONIC_INDEX])
        flow_out = scale * conductance * drive
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
    inlet = passing(state, params, 0)
    if inlet > 0.0:
        supply = inlet_pressure(state, params, absolute)
        critical = params[at.INLET_CRITICAL_RATIO]
        slope += inlet * params[at.INLET_CONDUCTANCE] * _factor_slope(absolute / supply, critical)
        leaving = change / (abs(supply - absolute) + flow.LINEAR_BELOW * supply)
    conductance = outward(state, params)
    if conductance > 0.0:
        atmosphere = params[at.ATMOSPHERE]
        critical = params[at.OUTLET_CRITICAL_RATIO]
        slope += conductance * _outward_slope(absolute, atmosphere, critical)
        gap = abs(absolute - atmosphere) + flow.LINEAR_BELOW * atmosphere
        leaving = max(leaving, change / gap)
    return max(slope * REFERENCE_DENSITY_KG_M3 * heat, 0.5 * leaving)


@inlined
def until_shut(state: Slots, params: Slots, absolute: float, volume: float) -> float:
    """Time in s after which a valve falls shut, as the gas flows now; 1 or more where none does."""
    soonest = 1.0
    heat = params[at.EXPONENT] * GAS_CONSTANT_J_KG_K * params[at.GAS_TEMPERATURE] / volume
    for which in range(2):
        closing = params[at.CLOSING + which]
        if closing > 0.0 and passing(state, params, which) > 0.0:
            flow_in, flow_out = flows(state, params, absolute)
            change = heat * abs(flow_in - flow_out)
            soonest = min(soonest, (_across(state, which) - closing) / max(change, 1.0))
    return soonest


@inlined
def fastest_load(state: Slots, params: Slots, absolute: float, volume: float, stop: bool) -> float:
    """Highest angular frequency of the hung mass on muscle, gas and stop, 1/s."""
    length = state[at.LENGTH]
    area = _volume_slope(length, params[at.BRAID_LENGTH], params[at.TURNS])
    stiffness = abs(_force_slope(state[at.PRESSURE], length, params[at.TURNS]))
    stiffness += params[at.EXPONENT] * absolute * area * area / volume
    damping = params[at.LOAD_DAMPING]
    stiffness = hooks.drag_stiffness(stiffness, params)
    if params[at.FORCE_EFFECTS] != 0.0:
        stiffness += added_stiffness(params, state[at.PRESSURE], length)
        damping += added_damping(params, state[at.PRESSURE], state[at.LENGTH_RATE])
    if stop:
        stiffness += params[at.STOP_STIFFNESS]
        damping += params[at.STOP_DAMPING]
    mass = carried(params)
    return math.sqrt(stiffness / mass) + damping / mass


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
