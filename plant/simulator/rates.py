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
from plant.physics import additions, flow, muscle
from plant.physics import layout as at
from plant.physics.friction import REFERENCE_PRESSURE_PA, element_slip

_factor = inlined(flow.subsonic_factor)
_factor_slope = inlined(flow.subsonic_slope)
_force = inlined(muscle.braid_force)
_force_slope = inlined(muscle.braid_force_slope)
_volume = inlined(muscle.braid_volume)
_volume_slope = inlined(muscle.braid_volume_slope)
_liner = inlined(muscle.liner_pressure)
_stretched = inlined(additions.stretched)
_effective_length = inlined(additions.effective_length)
_bladder = inlined(additions.bladder_force)
_bladder_slope = inlined(additions.bladder_slope)
_limit = inlined(additions.limit_force)
_viscous = inlined(additions.viscous_force)
_drooped = inlined(flow.drooped_supply)
element = inlined(element_slip)


@inlined
def tension(
    state: Slots, params: Slots, p: float, length: float, rate: float, slip: float
) -> float:
    """Force of the muscle in N; `slip` is the mean slip of the friction elements."""
    if params[at.MUSCLE_ADDITIONS] != 0.0 or params[at.CREEP_GAIN] != 0.0:
        pull = float(_with_additions(state, params, p, length, rate))
    else:
        pull = braid(params, p, length)
    if params[at.FRICTION_FORCE] != 0.0 and p > 0.0:
        pull -= params[at.FRICTION_FORCE] * p / REFERENCE_PRESSURE_PA * slip
    return pull


@inlined
def braid(params: Slots, p: float, length: float) -> float:
    """Force of the braid of nominal geometry behind its liner, N."""
    push = p
    if params[at.LINER_LOST] > 0.0:
        push = _liner(p, params[at.LINER_LOST], params[at.LINER_WIDTH])
    return _force(push, length, params[at.BRAID_LENGTH], params[at.TURNS])


@inlined
def _deformed(params: Slots, p: float, length: float) -> float:
    """Force of the braid with threads that stretch and ends that taper, N."""
    push = p
    if params[at.LINER_LOST] > 0.0:
        push = _liner(p, params[at.LINER_LOST], params[at.LINER_WIDTH])
    threads = _stretched(params[at.BRAID_LENGTH], p, params[at.STRETCH])
    inner = _effective_length(length, params[at.CAP_SHARE], params[at.CAP_REST])
    pull: float = _force(push, inner, threads, params[at.TURNS])
    return pull


@called
def lasting(state: Slots, params: Slots, p: float, length: float) -> float:
    """Force in N that would stay if pressure and length did: no friction, speed or creep."""
    pull = _deformed(params, p, length)
    if params[at.WARMING] != 0.0:
        grown = pull
        flat = params[at.WARMING_FLAT]
        if flat != 0.0:
            grown += flat * (_deformed(params, additions.STRETCH_PRESSURE_PA, length) - pull)
        warmer = state[at.TEMPERATURE] - params[at.WARMING_FROM]
        pull += params[at.WARMING] * warmer * grown
    pull *= 1.0 + params[at.WEAR] * state[at.TRIAL]
    if params[at.BLADDER] != 0.0:
        rest = params[at.BLADDER_REST]
        pull += _bladder(length, params[at.BLADDER], rest, params[at.BLADDER_HARDENING])
    if params[at.LIMIT_FORCE] != 0.0:
        lost = params[at.LIMIT_FORCE]
        pull -= _limit(length, lost, params[at.LENGTH_MIN], params[at.LIMIT_SCALE])
    return pull


@called
def _with_additions(state: Slots, params: Slots, p: float, length: float, rate: float) -> float:
    pull = lasting(state, params, p, length)
    if params[at.CREEP_GAIN] != 0.0:
        crept = 0.0
        for i in range(at.CREEP_ELEMENTS):
            crept += state[at.CREEP + i]
        pull -= params[at.CREEP_GAIN] * crept
    if params[at.VISCOUS] != 0.0:
        damping = params[at.VISCOUS]
        power_law = params[at.VISCOUS_EXPONENT]
        pull += _viscous(rate, p, damping, power_law, params[at.VISCOUS_PRESSURE])
    return pull


@called
def _added_stiffness(params: Slots, p: float, length: float) -> float:
    """How steeply the additions may change the force with length, N/m; never too little."""
    braid_share = params[at.CAP_SHARE] * abs(_force_slope(p, length, params[at.TURNS]))
    rest = params[at.BLADDER_REST]
    tube = abs(_bladder_slope(length, params[at.BLADDER], rest, params[at.BLADDER_HARDENING]))
    wall = 0.0
    if params[at.LIMIT_FORCE] != 0.0:
        lost = abs(params[at.LIMIT_FORCE])
        scale = params[at.LIMIT_SCALE]
        wall = _limit(length, lost, params[at.LENGTH_MIN], scale) / scale
    total: float = braid_share + tube + wall
    return total


@called
def _added_damping(params: Slots, p: float, rate: float) -> float:
    """How steeply the additions change the force with speed, N s/m."""
    exponent = params[at.VISCOUS_EXPONENT]
    pace = max(abs(rate), additions.VISCOUS_FLOOR_M_S)
    force = _viscous(pace, p, params[at.VISCOUS], exponent, params[at.VISCOUS_PRESSURE])
    slope: float = 1.5 * max(1.0, exponent) * abs(force) / pace
    return slope


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
def carried(params: Slots) -> float:
    """Mass in kg that really hangs on the muscle; a payload never takes more than is there."""
    return max(params[at.MASS] + params[at.EXTRA_MASS], 1e-3)


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
def inlet_pressure(state: Slots, params: Slots, absolute: float) -> float:
    """Absolute pressure upstream of the open inlet; `absolute` is that in the muscle."""
    supply = state[at.SUPPLY] + params[at.ATMOSPHERE]
    if params[at.SUPPLY_DROOP] > 0.0:
        critical = params[at.INLET_CRITICAL_RATIO]
        supply = _drooped(supply, absolute, params[at.SUPPLY_DROOP], critical)
    return supply


@inlined
def flows(state: Slots, params: Slots, absolute: float) -> tuple[float, float]:
    """Mass flow in and out in kg/s at absolute pressure `absolute` in the muscle."""
    scale = REFERENCE_DENSITY_KG_M3 * math.sqrt(
        REFERENCE_TEMPERATURE_K / params[at.GAS_TEMPERATURE]
    )
    flow_in = 0.0
    flow_out = 0.0
    if state[at.INLET_OPEN] > 0.0:
        supply = inlet_pressure(state, params, absolute)
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
        supply = inlet_pressure(state, params, absolute)
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
    if params[at.LINK_FRICTION] != 0.0:
        stiffness += params[at.LINK_FRICTION] / params[at.LINK_TRAVEL]
    if params[at.MUSCLE_ADDITIONS] != 0.0:
        stiffness += _added_stiffness(params, state[at.PRESSURE], length)
        damping += _added_damping(params, state[at.PRESSURE], state[at.LENGTH_RATE])
    if stop:
        stiffness += params[at.STOP_STIFFNESS]
        damping += params[at.STOP_DAMPING]
    mass = carried(params)
    return math.sqrt(stiffness / mass) + damping / mass


@inlined
def link_slip(state: Slots, params: Slots, dlength: float) -> float:
    """Slip of the joint or slide that carries the load after a further `dlength` of motion.

    One elasto-slip element (Prandtl; Armstrong-Helouvry, Dupont and Canudas de Wit 1994 on
    pre-sliding): it sticks like a stiff spring and slips at its limit, whatever the speed.
    """
    if params[at.LINK_FRICTION] == 0.0:
        return 0.0
    return min(1.0, max(-1.0, state[at.LINK_SLIP] + dlength / params[at.LINK_TRAVEL]))


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
