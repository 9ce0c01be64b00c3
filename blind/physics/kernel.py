"""The integrator: an embedded Bogacki-Shampine pair with steps fitted to every edge, compiled.

Steps end on command edges, on valve edges and on the corners of set-points; between them the
step follows the error. Output is by cubic Hermite interpolation.
Source: Bogacki and Shampine, Appl. Math. Letters 2 (1989) 321.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from blind.physics import alternatives
from blind.physics import numbers as n
from blind.physics.compiled import compiled
from blind.physics.laws import GAS, leak_flow, muscle_force, valve_flow, volume, volume_slope

GRAVITY = 9.80665
QUEUE = 64
# Valve memory: open flags, commands, time of last opening, lengths of the queues, count of fills,
# then queue times and states.
OPEN, COMMAND, SINCE, LENGTH, FILLS, TIMES = 0, 2, 4, 6, 8, 10
VALVE_CELLS = TIMES + 4 * QUEUE
Array = Any


@compiled
def along(times: Array, values: Array, t: float) -> Any:
    """Value and slope of a piecewise-linear course (flat outside)."""
    if t <= times[0]:
        return values[0], 0.0
    last = len(times) - 1
    if t >= times[last]:
        return values[last], 0.0
    i = np.searchsorted(times, t, side="right") - 1
    slope = (values[i + 1] - values[i]) / (times[i + 1] - times[i])
    return values[i] + slope * (t - times[i]), slope


@compiled
def slopes(
    t: float,
    y: Array,
    dy: Array,
    vs: Array,
    c: Array,
    e: Array,
    w: Array,
    regulated: bool,
    set_t: Array,
    set_v: Array,
    len_t: Array,
    len_v: Array,
) -> Any:
    """Fill dy/dt; return muscle force (N), length (mm), speed (mm/s), acceleration (mm/s2)."""
    pa = c[n.ATMOSPHERE]
    for i in range(n.STATES):
        dy[i] = 0.0
    p = y[n.Y_P]
    mass = c[n.MASS]
    if mass > 0.0:
        length, v = y[n.Y_L], y[n.Y_V]
    else:
        length, v = along(len_t, len_v, t)
    gauge = p - pa
    fall = 0.0
    if regulated:
        goal, _ = along(set_t, set_v, t)
        dp = (goal + pa - p) / c[n.REGULATOR_S]
    else:
        supply = c[n.SUPPLY]
        if e[n.DROOP, 0] >= 0.0:
            fall = y[n.Y_FALL]
            supply -= fall
        if e[n.SURGE, 0] >= 0.0:
            phase = (t - e[n.SURGE, 2]) / 0.12
            supply += e[n.SURGE, 1] * math.exp(-phase * phase)
        inflow, outflow = 0.0, 0.0
        if vs[OPEN] > 0.0:
            inflow = valve_flow(supply, p, 0, 1e3 * (t - vs[SINCE]), c, e)
        if vs[OPEN + 1] > 0.0:
            outflow = valve_flow(p, pa, 1, 1e3 * (t - vs[SINCE + 1]), c, e)
            if p < pa:  # shortened with its outlet open, a muscle draws air in
                outflow = -valve_flow(pa, p, 1, 1e3 * (t - vs[SINCE + 1]), c, e)
        outflow += leak_flow(p, c, e)
        vol = volume(length, c)
        extra = e[n.VOLUME, 1]
        form = e[n.VOLUME, 0]
        rt = GAS * c[n.GAS_K] * 1e-3  # kPa ml per mg
        gain = rt * (inflow - outflow)
        dv = volume_slope(length, c) * v
        if form == 0.0:
            vol += extra
        elif form == 2.0:  # a hose that swells: its volume is `extra` at 300 kPa
            vol += extra * (0.75 + 0.25 * gauge / 300.0) + p * extra * 0.25 / 300.0
        elif form == 1.0:  # a side branch behind a narrow place
            tau = e[n.VOLUME, 2]
            flow = (p - y[n.Y_SIDE]) / tau
            dy[n.Y_SIDE] = flow
            gain -= extra * flow
        elif form == 3.0:
            vol += extra * alternatives.swollen(gauge) + p * extra * alternatives.swelling(gauge)
        elif form == 4.0:
            flow = alternatives.side_flow(p - y[n.Y_SIDE], e[n.VOLUME, 2])
            dy[n.Y_SIDE] = flow
            gain -= extra * flow
        elif form == 5.0:  # its wall comes after the pressure
            dy[n.Y_SIDE] = alternatives.slow_wall(p, y[n.Y_SIDE])
            vol += extra * (0.35 + 0.65 * (y[n.Y_SIDE] - pa) / 300.0)
            dv += extra * 0.65 / 300.0 * dy[n.Y_SIDE]
        elif form == 6.0:
            flow = alternatives.valved_flow(p - y[n.Y_SIDE], e[n.VOLUME, 2])
            dy[n.Y_SIDE] = flow
            gain -= extra * flow
        elif form == 7.0:
            vol += extra * (alternatives.preloaded(gauge) + p * alternatives.springing(gauge))
        elif form == 8.0:  # what a drying agent holds
            flow = alternatives.sorbed_rate(gauge, y[n.Y_SIDE] - pa, e[n.VOLUME, 2])
            dy[n.Y_SIDE] = flow
            gain -= extra * flow
        k = c[n.EXPONENT]
        if e[n.POLYTROPIC, 0] >= 0.0:
            k = 1.0 + e[n.POLYTROPIC, 1]
            if e[n.POLYTROPIC, 0] == 2.0:  # filling mixes, venting cools
                if inflow > outflow:
                    k = 1.0 + 1.15 * e[n.POLYTROPIC, 1]
                elif outflow > inflow:
                    k = 1.0 + 0.85 * e[n.POLYTROPIC, 1]
            elif e[n.POLYTROPIC, 0] == 4.0:
                k = alternatives.exponent(e[n.POLYTROPIC, 1], t - max(vs[SINCE], vs[SINCE + 1]))
        dp = k * (gain - p * dv) / vol
        if e[n.POLYTROPIC, 0] == 1.0:  # and the wall brings it back to room temperature
            dy[n.Y_ISO] = (gain - y[n.Y_ISO] * dv) / vol
            dp -= (p - y[n.Y_ISO]) / e[n.POLYTROPIC, 2]
        elif e[n.POLYTROPIC, 0] == 3.0:
            dy[n.Y_ISO] = (gain - y[n.Y_ISO] * dv) / vol
            dp -= alternatives.wall_rate(p - y[n.Y_ISO], e[n.POLYTROPIC, 2])
        elif e[n.POLYTROPIC, 0] == 5.0:
            dy[n.Y_ISO] = (gain - y[n.Y_ISO] * dv) / vol
            flow = inflow + abs(outflow)
            dp -= alternatives.stirred_rate(p - y[n.Y_ISO], e[n.POLYTROPIC, 2], flow)
        if e[n.DROOP, 0] >= 0.0:
            if e[n.DROOP, 0] == 2.0:  # a regulator that sags with the flow
                dy[n.Y_FALL] = (e[n.DROOP, 2] * inflow**0.8 - fall) / 0.006
            elif e[n.DROOP, 0] >= 3.0:
                dy[n.Y_FALL] = alternatives.sag_rate(
                    e[n.DROOP, 0], e[n.DROOP, 2], e[n.DROOP, 3], inflow, fall
                )
            else:  # a small receiver behind a restriction
                dy[n.Y_FALL] = e[n.DROOP, 2] * inflow - fall / e[n.DROOP, 3]
    dy[n.Y_P] = dp
    force, static = muscle_force(gauge, length, v, y, c, e, w)
    if e[n.CREEP, 0] >= 0.0:
        for i in range(n.MEMORIES):
            if w[0, i] != 0.0:
                dy[n.Y_CREEP + i] = (static - y[n.Y_CREEP + i]) / w[1, i]
    if e[n.BRAID_FRICTION, 0] >= 0.0:
        rate = v / 0.25 - dp / e[n.BRAID_FRICTION, 3]
        way = 1.0 if rate > 0.0 else -1.0
        if e[n.BRAID_FRICTION, 0] == 2.0:  # four elements that yield one after the other
            for i in range(4):
                z = y[n.Y_SLIP + i]
                dy[n.Y_SLIP + i] = rate / (0.3 + 0.6 * i) * (1.0 - way * z * abs(z) ** 2)
        elif e[n.BRAID_FRICTION, 0] >= 3.0:
            dy[n.Y_SLIP] = alternatives.slip_rate(e[n.BRAID_FRICTION, 0], rate, y[n.Y_SLIP], 0.37)
        else:
            z = y[n.Y_SLIP]
            sharp = 3.0 if e[n.BRAID_FRICTION, 0] == 0.0 else 1.0
            dy[n.Y_SLIP] = sharp * rate * (1.0 - way * z)
    if e[n.P_LAG, 0] >= 0.0:
        tau = 1e-3 * e[n.P_LAG, 1]
        first = tau * (0.75 if e[n.P_LAG, 0] == 2.0 else 1.0)
        dy[n.Y_TAP] = (gauge - y[n.Y_TAP]) / first
        if e[n.P_LAG, 0] == 1.0:  # a narrow line: slower while far from its end
            dy[n.Y_TAP] *= 1.15 / (1.0 + 0.3 * abs(gauge - y[n.Y_TAP]) / 200.0)
        if e[n.P_LAG, 0] == 2.0:
            dy[n.Y_TAP + 1] = (y[n.Y_TAP] - y[n.Y_TAP + 1]) / (0.25 * tau)
        elif e[n.P_LAG, 0] >= 3.0:
            dy[n.Y_TAP], dy[n.Y_TAP + 1] = alternatives.tap_rates(
                e[n.P_LAG, 0], tau, gauge, y[n.Y_TAP], y[n.Y_TAP + 1], pa
            )
    accel = 0.0
    if mass > 0.0:
        real = mass
        if e[n.PAYLOAD, 0] >= 0.0:
            real += e[n.PAYLOAD, 1]
        pull = real * GRAVITY - force - c[n.LOAD_C] * v
        if e[n.PAYLOAD, 0] == 2.0:  # a hose that is lifted along
            pull += GRAVITY * e[n.PAYLOAD, 1] * 0.03 * (60.0 - length)
        elif e[n.PAYLOAD, 0] == 1.0:  # hangs on a soft guide
            pull += GRAVITY * e[n.PAYLOAD, 1] * 0.15 * math.tanh((60.0 - length) / 5.0)
        elif e[n.PAYLOAD, 0] == 3.0:
            pull += GRAVITY * e[n.PAYLOAD, 1] * (alternatives.lever(length) - 1.0)
        elif e[n.PAYLOAD, 0] == 4.0:
            pull += GRAVITY * e[n.PAYLOAD, 1] * (alternatives.chain(length, c[n.L_MAX]) - 1.0)
        if length > c[n.L_MAX]:
            pull -= c[n.STOP_K] * (length - c[n.L_MAX]) + c[n.STOP_C] * v
        elif length < c[n.L_MIN]:
            pull -= c[n.STOP_K] * (length - c[n.L_MIN]) + c[n.STOP_C] * v
        if e[n.SLIDE, 0] >= 0.0:
            if e[n.SLIDE, 0] == 2.0:  # Stribeck
                fall_off = 1.0 + 0.35 * math.exp(-((v / 4.0) ** 2))
                pull -= e[n.SLIDE, 1] * math.tanh(v / 0.4) * fall_off
            elif e[n.SLIDE, 0] == 1.0:  # Dahl
                z = y[n.Y_SLIDE]
                way = 1.0 if v > 0.0 else -1.0
                dy[n.Y_SLIDE] = v / e[n.SLIDE, 2] * (1.0 - way * z)
                pull -= e[n.SLIDE, 1] * z
            elif e[n.SLIDE, 0] >= 3.0:
                rate, z = v / e[n.SLIDE, 2], y[n.Y_SLIDE]
                dy[n.Y_SLIDE] = alternatives.slip_rate(e[n.SLIDE, 0], rate, z, 3.0 / e[n.SLIDE, 2])
                pull -= e[n.SLIDE, 1] * alternatives.slide_drag(e[n.SLIDE, 0], v, z)
            else:
                pull -= e[n.SLIDE, 1] * math.tanh(v / 0.1)
        if e[n.STICK, 0] >= 0.0:  # the slide is tight in one place, both ways
            near = (length - e[n.STICK, 2]) / 1.0
            pull -= e[n.STICK, 1] * math.exp(-near * near) * math.tanh(v / 0.5)
        accel = 1e3 * pull / real
        dy[n.Y_L] = v
        dy[n.Y_V] = accel
    return force, length, v, accel


@compiled
def delay_s(t: float, y: Array, vs: Array, c: Array, e: Array, side: int, on: bool) -> float:
    """Delay between a command's edge at t and the valve's, s."""
    at = n.IN_ON + 4 * side + (0 if on else 2)
    if side == 0:
        p = c[n.SUPPLY] - c[n.ATMOSPHERE]
        if e[n.DROOP, 0] >= 0.0:
            p -= y[n.Y_FALL]
    else:
        p = y[n.Y_P] - c[n.ATMOSPHERE]
    ms = c[at] + c[at + 1] * p
    edge = 2 * side + (0 if on else 1)
    if e[n.DELAY, 0] >= 0.0 and e[n.DELAY, 2] == edge:
        ms += e[n.DELAY, 1]
        if e[n.DELAY, 0] == 1.0:  # sticks a little more or less from fill to fill
            ms += 0.12 * e[n.DELAY, 1] * math.sin(2.4 * vs[FILLS] + 1.0)
        elif e[n.DELAY, 0] == 2.0:
            ms += 0.08 * e[n.DELAY, 1] * math.cos(1.7 * vs[FILLS])
        elif e[n.DELAY, 0] >= 3.0:
            rested = t - vs[SINCE + side]
            ms += alternatives.late(e[n.DELAY, 0], e[n.DELAY, 1], vs[FILLS], rested)
            ms -= e[n.DELAY, 1]
    if e[n.DELAY_SLOPE, 0] >= 0.0 and e[n.DELAY_SLOPE, 2] == edge:
        s = e[n.DELAY_SLOPE, 1]
        if e[n.DELAY_SLOPE, 0] == 1.0:  # quadratic, its slope exact at 300 kPa
            ms += s * (0.5 * p + p * p / 1200.0)
        elif e[n.DELAY_SLOPE, 0] == 2.0:  # saturating, its slope exact at 300 kPa
            ms += s * 600.0 * math.exp(0.5) * (1.0 - math.exp(-p / 600.0))
        elif e[n.DELAY_SLOPE, 0] >= 3.0:
            ms += alternatives.late_with_pressure(e[n.DELAY_SLOPE, 0], s, p)
        else:
            ms += s * p
    if e[n.COIL, 0] >= 0.0 and on:
        ms += e[n.COIL, 1] * (1.0 - math.exp(-vs[FILLS] / 6.0))
    return float(1e-3 * ms)


@compiled
def command(t: float, side: int, on: bool, y: Array, vs: Array, c: Array, e: Array) -> None:
    """Take a new command: queue the valve's edge, or drop one that comes to nothing."""
    if (vs[COMMAND + side] > 0.0) == on:
        return
    vs[COMMAND + side] = 1.0 if on else 0.0
    if on:
        vs[FILLS] += 1.0
    due = t + delay_s(t, y, vs, c, e, side, on)
    base = TIMES + 2 * QUEUE * side
    count = int(vs[LENGTH + side])
    if e[n.TRANSPORT, 0] < 0.0:  # inertial: what has not happened yet is forgotten
        count = 0
        if (vs[OPEN + side] > 0.0) == on:
            vs[LENGTH + side] = 0.0
            return
    elif e[n.TRANSPORT, 0] == 2.0 and count > 0:  # edges never overtake: a spool
        due = max(due, vs[base + count - 1] + 5e-4)
    elif e[n.TRANSPORT, 0] >= 3.0 and count > 0:
        due = alternatives.edge_after(e[n.TRANSPORT, 0], due, vs[base + count - 1])
        if math.isnan(due):  # neither edge happens
            vs[LENGTH + side] = count - 1
            return
    while count > 0 and vs[base + count - 1] >= due:
        count -= 1
    if count < QUEUE:
        vs[base + count] = due
        vs[base + QUEUE + count] = 1.0 if on else 0.0
        count += 1
    vs[LENGTH + side] = count


@compiled
def valve_edges(t: float, vs: Array) -> None:
    """Let every queued edge that is due happen."""
    for side in range(2):
        base = TIMES + 2 * QUEUE * side
        while vs[LENGTH + side] > 0.0 and vs[base] <= t + 1e-12:
            opens = vs[base + QUEUE]
            if opens > 0.0 and vs[OPEN + side] == 0.0:
                vs[SINCE + side] = vs[base]
            vs[OPEN + side] = opens
            count = int(vs[LENGTH + side])
            for i in range(count - 1):
                vs[base + i] = vs[base + i + 1]
                vs[base + QUEUE + i] = vs[base + QUEUE + i + 1]
            vs[LENGTH + side] = count - 1


@compiled
def next_edge(t: float, end: float, vs: Array, set_t: Array, len_t: Array) -> float:
    """The first instant after t at which something has a corner."""
    stop = end
    for side in range(2):
        base = TIMES + 2 * QUEUE * side
        if vs[LENGTH + side] > 0.0:
            stop = min(stop, max(vs[base], t))
    i = np.searchsorted(set_t, t + 1e-12, side="right")
    if i < len(set_t):
        stop = min(stop, set_t[i])
    i = np.searchsorted(len_t, t + 1e-12, side="right")
    if i < len(len_t):
        stop = min(stop, len_t[i])
    return stop
