"""Gas and load between two valve events, in compiled code.

The right-hand side is smooth there and is integrated by the classical Runge-Kutta method with a
bounded substep. The gas is carried as y = P V^k, which closed valves leave exactly alone whatever
the length does. What has a closed form (sealed gas, the regulator's lag) uses it, and a stop that
is touched ends a substep, so that its force never begins in the middle of one.

`state` and `params` are the arrays of `plant.physics.layout`.
"""

from __future__ import annotations

import numpy as np

from plant.compiled import Slots, called, inlined
from plant.constants import GAS_CONSTANT_J_KG_K
from plant.physics import layout as at
from plant.simulator import hooks
from plant.simulator.rates import (
    carried,
    chamber,
    fastest_gas,
    fastest_load,
    flows,
    lagged,
    lasting,
    outward,
    passing,
    power,
    regulated,
    sealed,
    stop_push,
    tension,
    until_shut,
)

# Absolute pressures within this ratio are equal: 0.6 mPa, where rounding would stall the approach.
_EQUAL = 1.0 + 1e-9
# A prescribed length stays above this share of the length at the short stop,
_TRAVEL_LOW = 0.2
# and below this share of the braid length.
_TRAVEL_HIGH = 0.99
# What remembers takes its inputs as straight lines over at most this time, s.
_MEMORY_STEP_S = 1e-3
# A valve that is about to fall shut is followed in steps of this time, s.
_SHUTS_S = 2e-5
# A load so near to a stop is on it.
_ON_STOP_M = 1e-11
_STAGE = np.array([0.0, 0.5, 0.5, 1.0])
_WEIGHT = np.array([1.0, 2.0, 2.0, 1.0]) / 6.0


@inlined
def _accept(state: Slots, params: Slots, p: float, length: float) -> None:
    """Take a new pressure and length into the state, sliding the fibres on the way."""
    hooks.slide(state, params, p - state[at.PRESSURE], length - state[at.LENGTH])
    state[at.PRESSURE] = p
    state[at.LENGTH] = length


@inlined
def _touched(params: Slots, length: float, rate: float) -> int:
    """Which stop is in play for the whole of the next substep: -1 the low one, 1 the high one."""
    if params[at.LOAD] == 0.0:
        return 0
    low = params[at.LENGTH_MIN]
    high = params[at.LENGTH_MAX]
    if length < low or (length == low and rate < 0.0):
        return -1
    if length > high or (length == high and rate > 0.0):
        return 1
    return 0


@called
def _substep(state: Slots, params: Slots, touched: int) -> float:
    """Longest step that follows the fastest part of the bench."""
    safety = params[at.STEP_SAFETY]
    step = params[at.STEP_MAX]
    absolute = state[at.PRESSURE] + params[at.ATMOSPHERE]
    volume = chamber(params, state[at.LENGTH])
    if not (sealed(state, params) or regulated(state, params)):
        step = min(step, safety / max(fastest_gas(state, params, absolute, volume), 1e-3))
        if params[at.CLOSING] > 0.0 or params[at.CLOSING + 1] > 0.0:
            step = min(step, max(until_shut(state, params, absolute, volume), _SHUTS_S))
    if params[at.LOAD] == 1.0:
        fastest = fastest_load(state, params, absolute, volume, touched != 0)
        step = min(step, 0.5 * safety / max(fastest, 1e-3))
    return step


@inlined
def _at_rest(state: Slots, params: Slots) -> bool:
    """Whether nothing moves and every open way is at equal pressure."""
    if params[at.LOAD] == 1.0 or state[at.LENGTH_RATE] != 0.0:
        return False
    atmosphere = params[at.ATMOSPHERE]
    absolute = state[at.PRESSURE] + atmosphere
    if passing(state, params, 0) > 0.0 and absolute * _EQUAL < state[at.SUPPLY] + atmosphere:
        return False
    if outward(state, params) == 0.0:
        return True
    return absolute <= atmosphere * _EQUAL and absolute * _EQUAL >= atmosphere


@inlined
def _end_of_travel(state: Slots, params: Slots, duration: float) -> None:
    """Stop a stage that would leave what a braid can be, before its formulas lose their meaning."""
    rate = state[at.LENGTH_RATE]
    if params[at.LOAD] == 0.0 and rate != 0.0:
        length = state[at.LENGTH] + rate * duration
        long = length > _TRAVEL_HIGH * params[at.BRAID_LENGTH]
        short = length < _TRAVEL_LOW * params[at.LENGTH_MIN]
        if (long and rate > 0.0) or (short and rate < 0.0):
            state[at.LENGTH_RATE] = 0.0


@called
def _closed_form(state: Slots, params: Slots, duration: float) -> None:
    """Prescribed length with sealed or regulated gas: exact for any duration."""
    atmosphere = params[at.ATMOSPHERE]
    length = state[at.LENGTH] + state[at.LENGTH_RATE] * duration
    if regulated(state, params):
        p = lagged(state, params, state[at.PRESSURE], duration)
        _book_regulated(state, params, p, length)
        _accept(state, params, p, length)
    elif length != state[at.LENGTH]:
        squeeze = chamber(params, state[at.LENGTH]) / chamber(params, length)
        absolute = (state[at.PRESSURE] + atmosphere) * power(squeeze, params[at.EXPONENT])
        _accept(state, params, absolute - atmosphere, length)


@inlined
def _book_regulated(state: Slots, params: Slots, p: float, length: float) -> None:
    """Account for the gas that the regulator passed on the way to a new pressure and length."""
    atmosphere = params[at.ATMOSPHERE]
    gained = (p + atmosphere) * chamber(params, length)
    gained -= (state[at.PRESSURE] + atmosphere) * chamber(params, state[at.LENGTH])
    gained /= GAS_CONSTANT_J_KG_K * params[at.GAS_TEMPERATURE]
    if gained > 0.0:
        state[at.MASS_IN] += gained
    else:
        state[at.MASS_OUT] -= gained


@inlined
def _onto_stop(state: Slots, params: Slots) -> None:
    """Put a load that has come within 0.01 nm of a stop onto it.

    A load that speeds up on its way falls a little short of where the secant leads it, again and
    again, by ever smaller steps: without this it would never arrive.
    """
    if params[at.LOAD] == 1.0:
        for stop in (params[at.LENGTH_MIN], params[at.LENGTH_MAX]):
            if abs(state[at.LENGTH] - stop) < _ON_STOP_M:
                state[at.LENGTH] = stop


@inlined
def _crossed(params: Slots, before: float, after: float) -> float:
    """Stop between two lengths, 0 if none; one that is left from exactly does not count."""
    if (before - params[at.LENGTH_MIN]) * (after - params[at.LENGTH_MIN]) < 0.0:
        return params[at.LENGTH_MIN]
    if (before - params[at.LENGTH_MAX]) * (after - params[at.LENGTH_MAX]) < 0.0:
        return params[at.LENGTH_MAX]
    return 0.0


@called
def _trial(
    state: Slots, params: Slots, touched: int, step: float
) -> tuple[float, float, float, float, float]:
    """One Runge-Kutta step: new y, length and rate, and the mass that went in and out."""
    hung = params[at.LOAD] == 1.0
    lagging = regulated(state, params)
    exponent = params[at.EXPONENT]
    atmosphere = params[at.ATMOSPHERE]
    heat = exponent * GAS_CONSTANT_J_KG_K * params[at.GAS_TEMPERATURE]
    p0 = state[at.PRESSURE]
    length0 = state[at.LENGTH]
    rate0 = state[at.LENGTH_RATE]
    y0 = (p0 + atmosphere) * power(chamber(params, length0), exponent)
    y = y0
    length = length0
    rate = rate0
    dy = 0.0
    dlength = 0.0
    drate = 0.0
    dy_mean = 0.0
    dlength_mean = 0.0
    drate_mean = 0.0
    flow_in_mean = 0.0
    flow_out_mean = 0.0
    for stage in range(4):
        after = _STAGE[stage] * step
        if stage > 0:
            y = y0 + after * dy
            length = length0 + after * dlength
            rate = rate0 + after * drate
        volume = chamber(params, length)
        if lagging:
            p = lagged(state, params, p0, after)
            flow_in = 0.0
            flow_out = 0.0
        else:
            absolute = y / power(volume, exponent)
            p = absolute - atmosphere
            flow_in, flow_out = flows(state, params, absolute)
        dy = heat * (flow_in - flow_out)
        if exponent != 1.0:
            dy *= volume ** (exponent - 1.0)
        dlength = rate
        if hung:
            pull = tension(state, params, p, length, rate)
            push = stop_push(params, touched, length, rate)
            net = push - pull - params[at.LOAD_DAMPING] * rate
            net -= hooks.drag(0.0, state, params, length)
            drate = params[at.GRAVITY] + net / carried(params)
        weight = _WEIGHT[stage]
        dy_mean += weight * dy
        dlength_mean += weight * dlength
        drate_mean += weight * drate
        flow_in_mean += weight * flow_in
        flow_out_mean += weight * flow_out
    return (
        y0 + step * dy_mean,
        length0 + step * dlength_mean,
        rate0 + step * drate_mean,
        step * flow_in_mean,
        step * flow_out_mean,
    )


@called
def _still(state: Slots, params: Slots) -> bool:
    """Whether pressure and length will stay as they are until a command comes."""
    if params[at.LOAD] == 1.0 or state[at.LENGTH_RATE] != 0.0 or regulated(state, params):
        return False
    return sealed(state, params) or _at_rest(state, params)


@called
def _remember(state: Slots, params: Slots, p0: float, pull0: float, duration: float) -> None:
    """Let effects with a memory follow a step in which pressure and force ran straight."""
    pull = lasting(state, params, state[at.PRESSURE], state[at.LENGTH])
    hooks.follow(state, params, p0, pull0, pull, duration)


@called
def integrate(state: Slots, params: Slots, duration: float) -> None:
    """Advance gas and load by `duration` seconds with the valves as they stand."""
    remembers = params[at.REMEMBERS] != 0.0
    ahead = duration
    while ahead > 0.0:
        left = ahead
        p0 = state[at.PRESSURE]
        pull0 = 0.0
        if remembers:
            pull0 = lasting(state, params, p0, state[at.LENGTH])
            if not _still(state, params):
                left = min(ahead, _MEMORY_STEP_S)
        part = left
        _end_of_travel(state, params, part)
        if params[at.LOAD] == 0.0 and (sealed(state, params) or regulated(state, params)):
            _closed_form(state, params, part)
            left = 0.0
        while left > 0.0 and not _at_rest(state, params):
            _onto_stop(state, params)
            length0 = state[at.LENGTH]
            touched = _touched(params, length0, state[at.LENGTH_RATE])
            step = min(left, _substep(state, params, touched))
            # At most twice more, by the secant, to end the substep on a stop that it crossed.
            for _ in range(3):
                y, length, rate, mass_in, mass_out = _trial(state, params, touched, step)
                stop = 0.0
                if params[at.LOAD] == 1.0 and step > 1e-8:
                    stop = _crossed(params, length0, length)
                if stop == 0.0:
                    break
                if abs(length - stop) < 1e-12:
                    length = stop
                    break
                step *= (stop - length0) / (length - length0)
            if regulated(state, params):
                p = lagged(state, params, state[at.PRESSURE], step)
                _book_regulated(state, params, p, length)
            else:
                p = y / power(chamber(params, length), params[at.EXPONENT]) - params[at.ATMOSPHERE]
                state[at.MASS_IN] += mass_in
                state[at.MASS_OUT] += mass_out
            _accept(state, params, p, length)
            state[at.LENGTH_RATE] = rate
            left -= step
        if remembers:
            _remember(state, params, p0, pull0, part)
        ahead -= part
