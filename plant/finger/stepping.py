"""Compiled integration of links, muscles and gas of a finger between two valve edges.

Between valve edges the state z = (q, q', P V^k of each muscle) is smooth, but stiff: the ratio of
damping to inertia at the tip is 4000 1/s, and a chamber near equal pressure is even faster. The
method is ROS34PW2, linearly implicit, of order 3, L-stable; it keeps its order with an approximate
Jacobian (Rang and Angermann 2005, BIT 45:761). The Jacobian used here contains joint damping and
stiffness divided by the inertia matrix, and the rate of each chamber.

Tendons can only pull: a muscle that would push leaves its tendon slack.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from plant.arrays import Array
from plant.compiled import Slots, called, inlined
from plant.constants import GAS_CONSTANT_J_KG_K, REFERENCE_DENSITY_KG_M3
from plant.links.kernel import DAMPING, mass_matrix, recurse, solve, turn
from plant.physics import flow
from plant.physics import layout as at
from plant.simulator import hooks
from plant.simulator.rates import (
    added_damping,
    chamber,
    flows,
    outward,
    power,
    sealed,
    tension,
)

JOINT, REST, ARM = 0, 1, 2
"""Columns of the table of tendons (muscles, 3): joint, length at angle 0 (m), dL/dq (m/rad)."""
LOW, HIGH, STOP_STIFFNESS, STOP_DAMPING = 0, 1, 2, 3
"""Columns of the table of stops (joints, 4): rad, rad, N m/rad, N m s/rad."""

_outward_slope = called(flow.outward_slope)
_factor_slope = inlined(flow.subsonic_slope)

# ROS34PW2 (Rang and Angermann 2005, table 4.2): gamma, alpha, gamma_ij; b is the last row.
_GAMMA = 0.435866521508459
_ALPHA = np.array(
    [
        [0.0, 0.0, 0.0],
        [0.87173304301691801, 0.0, 0.0],
        [0.84457060015369423, -0.11299064236484185, 0.0],
        [0.0, 0.0, 1.0],
    ]
)
_MIX = np.array(
    [
        [0.0, 0.0, 0.0],
        [-0.87173304301691801, 0.0, 0.0],
        [-0.90338057013044082, 0.054180672388095326, 0.0],
        [0.24212380706095346, -1.2232505839045147, 0.54526025533510214],
    ]
)
_B = np.array([0.24212380706095346, -1.2232505839045147, 1.5452602553351020, 0.43586652150845900])


@called
def pull_of(state: Slots, params: Slots, p: float, length: float, rate: float) -> float:
    """Tension of a tendon after the fibres slid to a new pressure and length, N."""
    return max(0.0, tension(state, params, p, length, rate))


@called
def _flows(state: Slots, params: Slots, absolute: float) -> tuple[float, float]:
    return flows(state, params, absolute)


@inlined
def _stop_torque(stops: Array, j: int, touched: float, q: float, qd: float) -> float:
    """Torque of a joint's stop; it acts only towards the range."""
    if touched == 0.0:
        return 0.0
    if touched < 0.0:
        push = stops[j, 2] * (stops[j, 0] - q) - stops[j, 3] * qd
        return max(0.0, float(push))
    push = stops[j, 2] * (q - stops[j, 1]) + stops[j, 3] * qd
    return -max(0.0, float(push))


@called
def _slopes(
    muscles: Array, params: Array, tendons: Array, stops: Array, box: Any, q: Array
) -> None:
    """Diagonal of the Jacobian: stiffness and damping of each joint, rate of each chamber."""
    table, _, _, _, _, stiffness, damping, gas, touched = box[:9]
    n = table.shape[0]
    for j in range(n):
        stiffness[j] = 0.0
        damping[j] = table[j, DAMPING]
        if touched[j] != 0.0:
            stiffness[j] += stops[j, 2]
            damping[j] += stops[j, 3]
    for i in range(tendons.shape[0]):
        state = muscles[i]
        par = params[i]
        arm = tendons[i, 2]
        length = state[at.LENGTH]
        volume = chamber(par, length)
        absolute = state[at.PRESSURE] + par[at.ATMOSPHERE]
        rate = state[at.LENGTH_RATE]
        pull = pull_of(state, par, state[at.PRESSURE], length, rate)
        if pull > 0.0:
            # dF/dL at constant gas mass, as a finite difference (works for any law).
            step = 1e-6
            more = chamber(par, length + step)
            p = absolute * power(volume / more, par[at.EXPONENT]) - par[at.ATMOSPHERE]
            slope = (pull_of(state, par, p, length + step, rate) - pull) / step
            stiffness[int(tendons[i, 0])] += max(0.0, slope) * arm * arm
            if added_damping(par, state[at.PRESSURE], rate) != 0.0:
                slope = pull_of(state, par, state[at.PRESSURE], length, rate + 1e-4) - pull
                damping[int(tendons[i, 0])] += max(0.0, slope) / 1e-4 * arm * arm
        gas[i] = 0.0
        if sealed(state, par):
            continue
        heat = par[at.EXPONENT] * GAS_CONSTANT_J_KG_K * par[at.GAS_TEMPERATURE]
        leak = 0.0
        if state[at.INLET_OPEN] > 0.0:
            supply = state[at.SUPPLY] + par[at.ATMOSPHERE]
            critical = par[at.INLET_CRITICAL_RATIO]
            if absolute < supply:
                leak += par[at.INLET_CONDUCTANCE] * _factor_slope(absolute / supply, critical)
        conductance = outward(state, par)
        if conductance > 0.0:
            critical = par[at.OUTLET_CRITICAL_RATIO]
            leak += conductance * _outward_slope(absolute, par[at.ATMOSPHERE], critical)
        gas[i] = -leak * REFERENCE_DENSITY_KG_M3 * heat / volume


@called
def _derivative(
    muscles: Array, params: Array, tendons: Array, stops: Array, box: Any, z: Array, out: Array
) -> bool:
    """Derivative of z. False if the arm's inertia matrix is singular."""
    table, gravity, work, d, zero, _, _, _, touched = box[:9]
    n = table.shape[0]
    q = z[:n]
    qd = z[n : 2 * n]
    acceleration = out[n : 2 * n]
    turn(table, q, work)
    recurse(table, gravity, qd, zero, work, acceleration)
    for j in range(n):
        out[j] = qd[j]
        push = _stop_torque(stops, j, touched[j], q[j], qd[j])
        acceleration[j] = push - acceleration[j] - table[j, DAMPING] * qd[j]
    for i in range(tendons.shape[0]):
        state = muscles[i]
        par = params[i]
        j = int(tendons[i, 0])
        length = tendons[i, 1] + tendons[i, 2] * q[j]
        volume = chamber(par, length)
        exponent = par[at.EXPONENT]
        absolute = z[2 * n + i] / power(volume, exponent)
        p = absolute - par[at.ATMOSPHERE]
        rate = tendons[i, 2] * qd[j]
        acceleration[j] -= pull_of(state, par, p, length, rate) * tendons[i, 2]
        change = 0.0
        if not sealed(state, par):
            flow_in, flow_out = _flows(state, par, absolute)
            change = (flow_in - flow_out) * GAS_CONSTANT_J_KG_K * par[at.GAS_TEMPERATURE]
            if exponent != 1.0:
                change *= exponent * volume ** (exponent - 1.0)
        out[2 * n + i] = change
    mass_matrix(table, work, d)
    return solve(d, acceleration)


@called
def _trial(
    muscles: Array, params: Array, tendons: Array, stops: Array, box: Any, step: float
) -> bool:
    """One step of ROS34PW2 from z to z_new in `box`."""
    table, _, work, _, _, stiffness, damping, gas, _, inertia, factor, z, stage, rate, k, new = box
    n = table.shape[0]
    m = tendons.shape[0]
    size = 2 * n + m
    turn(table, z[:n], work)
    mass_matrix(table, work, inertia)
    for i in range(size):
        new[i] = z[i]
    for s in range(4):
        for i in range(size):
            total = z[i]
            for r in range(s):
                total += _ALPHA[s, r] * k[r, i]
            stage[i] = total
        if not _derivative(muscles, params, tendons, stops, box[:9], stage, rate):
            return False
        # (D + h g B + h^2 g^2 K) kv = D h a - h K (Sq + g (h v + h Sv)) - h B Sv
        for i in range(n):
            for j in range(n):
                factor[i, j] = inertia[i, j]
            factor[i, i] += step * _GAMMA * (damping[i] + step * _GAMMA * stiffness[i])
        for j in range(n):
            mix_q = 0.0
            mix_v = 0.0
            for r in range(s):
                mix_q += _MIX[s, r] * k[r, j]
                mix_v += _MIX[s, r] * k[r, n + j]
            known = step * (rate[j] + mix_v)
            k[s, j] = known
            total = 0.0
            for i in range(n):
                total += inertia[j, i] * rate[n + i]
            total *= step
            total -= step * (stiffness[j] * (mix_q + _GAMMA * known) + damping[j] * mix_v)
            k[s, n + j] = total
        if not solve(factor, k[s, n : 2 * n]):
            return False
        for j in range(n):
            k[s, j] += step * _GAMMA * k[s, n + j]
        for i in range(m):
            mix = 0.0
            for r in range(s):
                mix += _MIX[s, r] * k[r, 2 * n + i]
            slope = step * gas[i]
            k[s, 2 * n + i] = (step * rate[2 * n + i] + slope * mix) / (1.0 - _GAMMA * slope)
        for i in range(size):
            new[i] += _B[s] * k[s, i]
    return True


@inlined
def _touch(stops: Array, q: Array, qd: Array, touched: Array) -> None:
    """Set the stop in contact with each joint for the next step: -1 low, 1 high, 0 none."""
    for j in range(stops.shape[0]):
        touched[j] = 0.0
        if q[j] < stops[j, 0] or (q[j] == stops[j, 0] and qd[j] < 0.0):
            touched[j] = -1.0
        elif q[j] > stops[j, 1] or (q[j] == stops[j, 1] and qd[j] > 0.0):
            touched[j] = 1.0


@inlined
def _crossing(stops: Array, before: Array, after: Array) -> float:
    """Fraction of the step at which the first stop is crossed; 1 if none is.

    A stop at which the step starts exactly does not count.
    """
    first = 1.0
    for j in range(stops.shape[0]):
        for side in range(2):
            stop = stops[j, side]
            if (before[j] - stop) * (after[j] - stop) < 0.0 and abs(after[j] - stop) > 1e-12:
                first = min(first, (stop - before[j]) / (after[j] - before[j]))
    return first


@called
def _accept(muscles: Array, params: Array, tendons: Array, box: Any) -> None:
    """Copy the new z to the muscles' rows and update the slip of the fibres."""
    n = box[0].shape[0]
    z = box[11]
    new = box[15]
    for i in range(2 * n + tendons.shape[0]):
        z[i] = new[i]
    for i in range(tendons.shape[0]):
        state = muscles[i]
        par = params[i]
        j = int(tendons[i, 0])
        length = tendons[i, 1] + tendons[i, 2] * z[j]
        absolute = z[2 * n + i] / power(chamber(par, length), par[at.EXPONENT])
        p = absolute - par[at.ATMOSPHERE]
        hooks.slide(state, par, p - state[at.PRESSURE], length - state[at.LENGTH])
        state[at.PRESSURE] = p
        state[at.LENGTH] = length
        state[at.LENGTH_RATE] = tendons[i, 2] * z[n + j]


@called
def integrate(
    muscles: Array,
    params: Array,
    tendons: Array,
    stops: Array,
    box: Any,
    duration: float,
    step_max: float,
) -> bool:
    """Advance by `duration` with constant valve positions."""
    n = box[0].shape[0]
    touched, z, new = box[8], box[11], box[15]
    left = duration
    while left > 0.0:
        # Equal steps up to the end, to avoid a very short last step.
        step = left / max(1.0, math.ceil(left / step_max - 1e-9))
        _touch(stops, z[:n], z[n : 2 * n], touched)
        _slopes(muscles, params, tendons, stops, box[:9], z[:n])
        for attempt in range(4):
            if not _trial(muscles, params, tendons, stops, box, step):
                return False
            share = _crossing(stops, z[:n], new[:n])
            if share == 1.0 or step < 1e-7 or attempt == 3:
                break
            step *= share
        for j in range(n):
            # Remove rounding errors at a stop.
            for side in range(2):
                if abs(new[j] - stops[j, side]) < 1e-12:
                    new[j] = stops[j, side]
        _accept(muscles, params, tendons, box)
        left -= step
        if left < 1e-15:
            break
    return True
