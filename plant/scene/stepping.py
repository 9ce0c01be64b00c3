"""Compiled integration of gas and mechanism of a scene between two valve events.

As in `plant.simulator.stepping` for one muscle: classical Runge-Kutta for y = P V^k of every
chamber and for position and rate of every coordinate, with a substep limited by the fastest of
them. Events only happen at the end of a substep: at contact with a stop, or when Coulomb friction
sticks or slips, the substep is shortened to end there.
"""

from __future__ import annotations

import math

import numpy as np

from plant.compiled import inlined
from plant.constants import GAS_CONSTANT_J_KG_K, REFERENCE_DENSITY_KG_M3
from plant.links import kernel as links
from plant.physics import flow
from plant.physics import layout as at
from plant.scene import layout as sc
from plant.scene.events import release
from plant.scene.layout import World
from plant.scene.rates import (
    gas_volume,
    link_drag,
    unit_damping,
    unit_force,
    unit_stiffness,
    volume_slope,
)
from plant.simulator.rates import (
    fastest_gas,
    flows,
    inlet_pressure,
    lagged,
    outward,
    power,
    regulated,
    sealed,
)

_STAGE = np.array([0.0, 0.5, 0.5, 1.0])
_WEIGHT = np.array([1.0, 2.0, 2.0, 1.0]) / 6.0
# Time after which the longest step of an arm is computed again, s.
_KEEP = 1e-3


@inlined
def length_at(w: World, k: int, places: int) -> float:
    """Length of unit `k` with the coordinates in row `places` of `work`."""
    n = w.coords.shape[0]
    length = w.reach[k, n]
    for j in range(n):
        length += w.reach[k, j] * w.work[places, j]
    return float(length)


@inlined
def _moving(w: World, k: int) -> float:
    """Present dL/dt of unit `k`."""
    speed = 0.0
    for j in range(w.coords.shape[0]):
        speed += w.reach[k, j] * w.motion[sc.RATE, j]
    return speed


@inlined
def _stop(w: World, j: int, q: float, rate: float) -> float:
    """Force of the active stop on coordinate `j`; a stop can only push."""
    touched = w.work[sc.TOUCH, j]
    if touched == 0.0:
        return 0.0
    stiffness, damping = w.coords[j, sc.STOP_STIFFNESS], w.coords[j, sc.STOP_DAMPING]
    if touched < 0.0:
        return float(max(0.0, stiffness * (w.coords[j, sc.LOW] - q) - damping * rate))
    return float(-max(0.0, stiffness * (q - w.coords[j, sc.HIGH]) + damping * rate))


@inlined
def slopes(w: World, after: float) -> None:
    """Derivatives at the trial state in `work`, `after` seconds into the substep.

    Reads rows Y, Q and QD; writes DY, FLOW_IN, FLOW_OUT and DQD. Row TORQUE gets the net force on
    each coordinate without Coulomb friction.
    """
    n = w.coords.shape[0]
    for j in range(n):
        q, rate = w.work[sc.Q, j], w.work[sc.QD, j]
        push = w.coords[j, sc.PULL] - w.coords[j, sc.DAMPING] * rate
        push -= w.coords[j, sc.SPRING] * (q - w.coords[j, sc.SPRING_REST])
        w.work[sc.TORQUE, j] = push + _stop(w, j, q, rate)
    for k in range(w.units.shape[0]):
        length = length_at(w, k, sc.Q)
        volume = gas_volume(w, k, length)
        params = w.params[k]
        exponent = params[at.EXPONENT]
        how = w.work[sc.OPEN, k]
        w.work[sc.DY, k] = 0.0
        w.work[sc.FLOW_IN, k] = 0.0
        w.work[sc.FLOW_OUT, k] = 0.0
        if how == sc.LEVEL:
            p = w.units[k, at.PRESSURE]
        elif how == sc.REGULATED:
            p = lagged(w.units[k], params, w.units[k, at.PRESSURE], after)
        else:
            absolute = w.work[sc.Y, k] / power(volume, exponent)
            p = absolute - params[at.ATMOSPHERE]
            if how == sc.FLOWING:
                flow_in, flow_out = flows(w.units[k], params, absolute)
                heat = exponent * GAS_CONSTANT_J_KG_K * params[at.GAS_TEMPERATURE]
                if exponent != 1.0:
                    heat *= volume ** (exponent - 1.0)
                w.work[sc.DY, k] = heat * (flow_in - flow_out)
                w.work[sc.FLOW_IN, k] = flow_in
                w.work[sc.FLOW_OUT, k] = flow_out
        if n > 0:
            rate = 0.0
            for j in range(n):
                rate += w.reach[k, j] * w.work[sc.QD, j]
            pull = unit_force(w, k, p, length, rate) + link_drag(w, k, length)
            for j in range(n):
                w.work[sc.TORQUE, j] -= w.reach[k, j] * pull
    if w.arm.shape[0] > 0:
        fine = links.forward(
            w.arm,
            w.gravity,
            w.work[sc.Q, :n],
            w.work[sc.QD, :n],
            w.work[sc.TORQUE, :n],
            w.links,
            w.matrix,
            w.work[sc.DQD, :n],
        )
        if not fine:
            w.clock[sc.TROUBLE] = 1.0
    else:
        for j in range(n):
            coulomb = w.coords[j, sc.COULOMB]
            push = w.work[sc.TORQUE, j]
            if coulomb > 0.0:
                way = w.motion[sc.SLIDING, j]
                push = 0.0 if way == 0.0 else push - way * coulomb
            w.work[sc.DQD, j] = push / w.coords[j, sc.MASS]


@inlined
def trial(w: World, now: float, step: float) -> None:
    """One Runge-Kutta step from the present state; rows Y, Q, QD, IN and OUT get its end.

    Static friction is checked with the first derivatives.
    """
    n, m = w.coords.shape[0], w.units.shape[0]
    work = w.work
    for k in range(m):
        work[sc.Y, k] = work[sc.Y0, k]
        work[sc.DY_SUM, k] = 0.0
        work[sc.IN, k] = 0.0
        work[sc.OUT, k] = 0.0
    for j in range(n):
        work[sc.Q, j] = w.motion[sc.PLACE, j]
        work[sc.QD, j] = w.motion[sc.RATE, j]
        work[sc.Q_SUM, j] = 0.0
        work[sc.QD_SUM, j] = 0.0
    for stage in range(4):
        after = _STAGE[stage] * step
        if stage > 0:
            for k in range(m):
                work[sc.Y, k] = work[sc.Y0, k] + after * work[sc.DY, k]
            for j in range(n):
                work[sc.Q, j] = w.motion[sc.PLACE, j] + after * work[sc.QD, j]
                work[sc.QD, j] = w.motion[sc.RATE, j] + after * work[sc.DQD, j]
        slopes(w, after)
        if stage == 0 and n > 0:
            for j in range(n):
                w.motion[sc.PUSH, j] = work[sc.TORQUE, j]
            release(w, now)
        weight = _WEIGHT[stage]
        for k in range(m):
            work[sc.DY_SUM, k] += weight * work[sc.DY, k]
            work[sc.IN, k] += weight * work[sc.FLOW_IN, k]
            work[sc.OUT, k] += weight * work[sc.FLOW_OUT, k]
        for j in range(n):
            work[sc.Q_SUM, j] += weight * work[sc.QD, j]
            work[sc.QD_SUM, j] += weight * work[sc.DQD, j]
    for k in range(m):
        work[sc.Y, k] = work[sc.Y0, k] + step * work[sc.DY_SUM, k]
        work[sc.IN, k] *= step
        work[sc.OUT, k] *= step
    for j in range(n):
        work[sc.Q, j] = w.motion[sc.PLACE, j] + step * work[sc.Q_SUM, j]
        work[sc.QD, j] = w.motion[sc.RATE, j] + step * work[sc.QD_SUM, j]


@inlined
def _gas_state(w: World, k: int, absolute: float, length: float) -> float:
    """SEALED, FLOWING, REGULATED or LEVEL for the next substep.

    LEVEL: one path is open, the pressures are equal within `flow.LINEAR_BELOW`, and the volume
    changes too slowly to increase the difference. The ISO 6358 ellipse is steep there: integrating
    it would need steps of microseconds for less than 7 Pa.
    """
    state, params = w.units[k], w.params[k]
    if regulated(state, params):
        return sc.REGULATED
    if sealed(state, params):
        return sc.SEALED
    out = outward(state, params)
    inlet = state[at.INLET_OPEN] > 0.0
    # A leak alone has too little conductance to be steep.
    if (inlet and out > 0.0) or not (inlet or state[at.OUTLET_OPEN] > 0.0):
        return sc.FLOWING
    if inlet:
        beyond = inlet_pressure(state, params, absolute)
        conductance = params[at.INLET_CONDUCTANCE]
    else:
        beyond = params[at.ATMOSPHERE]
        conductance = out
    if abs(absolute - beyond) > flow.LINEAR_BELOW * beyond:
        return sc.FLOWING
    swell = absolute * abs(volume_slope(w, k, length) * _moving(w, k))
    need = swell / (GAS_CONSTANT_J_KG_K * params[at.GAS_TEMPERATURE])
    passes = conductance * REFERENCE_DENSITY_KG_M3 * beyond * math.sqrt(2.0 * flow.LINEAR_BELOW)
    return sc.LEVEL if need < passes else sc.FLOWING


@inlined
def touches(w: World) -> float:
    """Set row TOUCH to the active stop of each coordinate; returns a code for the combination."""
    code = 0.0
    for j in range(w.coords.shape[0]):
        q, rate = w.motion[sc.PLACE, j], w.motion[sc.RATE, j]
        low, high = w.coords[j, sc.LOW], w.coords[j, sc.HIGH]
        touched = 0.0
        if q < low or (q == low and rate < 0.0):
            touched = -1.0
        elif q > high or (q == high and rate > 0.0):
            touched = 1.0
        w.work[sc.TOUCH, j] = touched
        code = 3.0 * code + touched
    return code


@inlined
def _longest(w: World) -> float:
    """Longest step for the present state of the mechanism, s.

    An oscillation needs an accurate phase; a damped motion only needs stability, because it decays
    within a step or two. So they have separate limits: LOAD_SAFETY for the angular frequency,
    DAMPING_SAFETY for the damping rate.
    """
    n = w.coords.shape[0]
    for j in range(n):
        stiff, damping = w.coords[j, sc.SPRING], w.coords[j, sc.DAMPING]
        if w.work[sc.TOUCH, j] != 0.0:
            stiff += w.coords[j, sc.STOP_STIFFNESS]
            damping += w.coords[j, sc.STOP_DAMPING]
        w.work[sc.STIFF, j] = stiff
        w.work[sc.TORQUE, j] = damping
    for k in range(w.units.shape[0]):
        absolute = w.units[k, at.PRESSURE] + w.params[k, at.ATMOSPHERE]
        stiff = unit_stiffness(w, k, absolute, gas_volume(w, k, w.units[k, at.LENGTH]))
        damping = unit_damping(w, k)
        for j in range(n):
            w.work[sc.STIFF, j] += stiff * w.reach[k, j] * w.reach[k, j]
            w.work[sc.TORQUE, j] += damping * w.reach[k, j] * w.reach[k, j]
    square = damped = 0.0
    if w.arm.shape[0] == 0:
        for j in range(n):
            square = max(square, w.work[sc.STIFF, j] / w.coords[j, sc.MASS])
            damped = max(damped, w.work[sc.TORQUE, j] / w.coords[j, sc.MASS])
    else:
        links.turn(w.arm, w.motion[sc.PLACE], w.links)
        column = w.work[sc.DQD, :n]
        for j in range(n):
            links.mass_matrix(w.arm, w.links, w.matrix)
            for i in range(n):
                column[i] = 0.0
            column[j] = 1.0
            if not links.solve(w.matrix, column):
                w.clock[sc.TROUBLE] = 1.0
                return 1e-3
            # The trace of D^-1 K is at least its largest eigenvalue.
            square += column[j] * w.work[sc.STIFF, j]
            damped += column[j] * (w.work[sc.TORQUE, j] + w.arm[j, links.DAMPING])
    step = w.clock[sc.LOAD_SAFETY] / max(math.sqrt(square), 1e-3)
    return float(min(step, w.clock[sc.DAMPING_SAFETY] / max(damped, 1e-3)))


@inlined
def substep(w: World, now: float, touching: float) -> float:
    """Longest step for the fastest part of the scene; sets OPEN and Y0 of each unit."""
    step = w.clock[sc.STEP_MAX]
    for k in range(w.units.shape[0]):
        state, params = w.units[k], w.params[k]
        absolute = state[at.PRESSURE] + params[at.ATMOSPHERE]
        volume = gas_volume(w, k, state[at.LENGTH])
        how = _gas_state(w, k, absolute, state[at.LENGTH])
        w.work[sc.OPEN, k] = how
        w.work[sc.Y0, k] = absolute * power(volume, params[at.EXPONENT])
        if how == sc.FLOWING:
            fastest = fastest_gas(state, params, absolute, volume)
            step = min(step, w.clock[sc.GAS_SAFETY] / max(fastest, 1e-3))
    if w.coords.shape[0] > 0:
        kept = now < w.clock[sc.LONGEST_UNTIL] and touching == w.clock[sc.LONGEST_TOUCH]
        if not kept:
            w.clock[sc.LONGEST] = _longest(w)
            w.clock[sc.LONGEST_UNTIL] = now + (_KEEP if w.arm.shape[0] > 0 else 0.0)
            w.clock[sc.LONGEST_TOUCH] = touching
        step = min(step, w.clock[sc.LONGEST])
    return float(step)
