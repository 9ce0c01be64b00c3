"""The pressure stage: commands, supply and measured length in, predicted pressure reading out.

The physics is that of docs/reference/plant.md; what differs from the simulator is that
it follows the measurement from afar: the prediction is drawn towards the reading with a time
constant of seconds, so that one cause early in a trial does not drown what comes after it, while
everything quicker, and every steady drift, stays in the residual. Whole data sets run in one
compiled call, which is what lets the diagnosis try a hundred suspects in a second.

`replay` runs free of the measurement instead. What the real gas did beyond the model is kept as one
small step of pressure for each node: what the reading gains over the model sent off from the
reading one node before. Summed up these steps are the measured pressure itself, never a slope of
it: a replay without any of them is the model alone, one with all of them the measurement again.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from plant.compiled import called, entry_point, fingerprint, inlined
from plant.constants import (
    GAS_CONSTANT_J_KG_K,
    REFERENCE_DENSITY_KG_M3,
    REFERENCE_TEMPERATURE_K,
)
from plant.physics import flow, muscle

Array = npt.NDArray[np.float64]

# Slots of the parameter array, SI.
ATMOSPHERE = 0
TEMPERATURE = 1
BRAID = 2
TURNS = 3
AREA_IN = 4
AREA_OUT = 5
RATIO_IN = 6
RATIO_OUT = 7
VOLUME = 8
EXPONENT = 9
SUPPLY_SHIFT = 10
DELAY = 11  # four delays: inlet on, inlet off, outlet on, outlet off
DELAY_SLOPE = 15  # s/Pa, same order
TRANSPORT = 19
LEAK = 20
LEAK_LAMINAR = 21
DROOP = 22
DROOP_TIME = 23
HEAT_RATE = 24
ZERO = 25
GAIN = 26
LAG = 27
CLOCK = 28
FOLLOW = 29
ELASTIC = 30
LINE = 31
LINE_TIME = 32
DROOP_BACK = 33
LAG_BEFORE = 34
AREA_DROP_IN = 35  # change of the areas at DROP_PA over the valve
AREA_DROP_OUT = 36
DROP_PA = 5e5
SIZE = 40

_factor = inlined(flow.subsonic_factor)
_braid_volume = inlined(muscle.braid_volume)
_PENDING = 32
_FOLLOW, _LEARN, _APPLY = 0, 1, 2
ACTS_S = 0.03
"""Seconds after a command's edge in which a valve may still move."""


@inlined
def laminar_drop(absolute: float, outside: float) -> float:
    """What drives a laminar leak, Pa: the squares of both pressures differ.

    Stated so that the leak passes as much as a choked orifice of its conductance at 400 kPa gauge.
    """
    at = 4e5 + outside
    return at * (absolute * absolute - outside * outside) / (at * at - outside * outside)


@inlined
def _flows(
    q: Any, p: float, supply: float, inlet: bool, outlet: bool, fall: float
) -> tuple[float, float, float]:
    """Mass flow in, mass flow out (kg/s), and the inlet's flow as a share of choked flow."""
    scale = REFERENCE_DENSITY_KG_M3 * math.sqrt(REFERENCE_TEMPERATURE_K / q[TEMPERATURE])
    absolute = p + q[ATMOSPHERE]
    flow_in = 0.0
    flow_out = 0.0
    share = 0.0
    if inlet:
        above = max(supply - fall, -0.9 * q[ATMOSPHERE]) + q[ATMOSPHERE]
        share = _factor(absolute / above, q[RATIO_IN])
        wider = 1.0 + q[AREA_DROP_IN] * (supply - fall - p) / DROP_PA
        flow_in = scale * q[AREA_IN] * max(wider, 0.02) * above * share
    out_ratio = q[ATMOSPHERE] / absolute
    area = q[LEAK]
    if outlet:
        area += q[AREA_OUT] * max(1.0 + q[AREA_DROP_OUT] * p / DROP_PA, 0.02)
    if area > 0.0:
        flow_out = scale * area * absolute * _factor(out_ratio, q[RATIO_OUT])
    if q[LEAK_LAMINAR] != 0.0:
        flow_out += scale * q[LEAK_LAMINAR] * laminar_drop(absolute, q[ATMOSPHERE])
    return flow_in, flow_out, share


@called
def _advance(
    q: Any, s: Any, span: float, v0: float, v1: float, supply: float, inlet: bool, outlet: bool
) -> None:
    """Move gas state s over `span` s.

    It is (pressure, isothermal pressure, reading, fall, line, pressure at the sensor).
    """
    left = span
    v = v0
    slope = (v1 - v0) / span
    k = q[EXPONENT]
    heat = GAS_CONSTANT_J_KG_K * q[TEMPERATURE]
    at = q[ATMOSPHERE]
    quiet = not inlet and not outlet and q[LEAK] == 0.0 and q[LEAK_LAMINAR] == 0.0
    quiet = quiet and q[LINE] == 0.0 and q[ELASTIC] == 0.0
    while left > 1e-12:
        p = s[0]
        flow_in, flow_out, share = _flows(q, p, supply, inlet, outlet, s[3])
        # A hose that widens takes gas as if the volume were larger by this much.
        wide = q[ELASTIC] * (2.0 * max(p, 0.0) + at)
        rate = k * heat * (flow_in - flow_out) / (v + wide) - k * (p + at) * slope / v
        if q[LINE] > 0.0:
            rate -= q[LINE] / v * (p - s[4]) / q[LINE_TIME]
        h = left
        if not quiet:
            # A step changes the pressure by a third of what drives the flow, at most.
            drive = 1e9
            if inlet:
                drive = abs(supply - s[3] - p) + 200.0
            if outlet or q[LEAK] > 0.0:
                drive = min(drive, abs(p) + 200.0)
            h = min(left, max(0.3 * drive / (abs(rate) + 1.0), 2e-5))
            h = min(h, 2e-3)
        if q[LINE] > 0.0:
            h = min(h, 0.3 * q[LINE_TIME])
        if q[DROOP_TIME] > 0.0 and inlet:
            h = min(h, 0.3 * q[DROOP_TIME])
        v_next = v + slope * h
        if quiet:
            p1 = (p + at) * (v / v_next) ** k - at if slope != 0.0 else p
            iso = (s[1] + at) * v / v_next - at
        else:
            p_try = max(p + h * rate, -0.95 * at)
            in2, out2, share = _flows(q, p_try, supply, inlet, outlet, s[3])
            wide = q[ELASTIC] * (2.0 * max(p_try, 0.0) + at)
            rate2 = k * heat * (in2 - out2) / (v_next + wide) - k * (p_try + at) * slope / v_next
            if q[LINE] > 0.0:
                rate2 -= q[LINE] / v_next * (p_try - s[4]) / q[LINE_TIME]
            p1 = p + 0.5 * h * (rate + rate2)
            mass = 0.5 * h * (flow_in - flow_out + in2 - out2)
            iso = ((s[1] + at) * v + heat * mass) / v_next - at
            # Flow ends at equal pressure; no step may carry the gas beyond.
            alone = slope == 0.0 and q[LINE] == 0.0
            if inlet and not outlet and p <= supply - s[3] and alone:
                p1 = min(p1, supply - s[3])
            if outlet and not inlet and p >= 0.0 and alone:
                p1 = max(p1, 0.0)
        if q[LINE] > 0.0:
            s[4] += (p - s[4]) * (1.0 - math.exp(-h / q[LINE_TIME]))
        if q[HEAT_RATE] > 0.0:
            p1 += (iso - p1) * (1.0 - math.exp(-h * q[HEAT_RATE]))
        target = q[DROOP] * share if inlet else 0.0
        droop_time = q[DROOP_TIME]
        if target < s[3] and q[DROOP_BACK] > 0.0:
            droop_time = q[DROOP_BACK]
        if droop_time > 0.0:
            s[3] += (target - s[3]) * (1.0 - math.exp(-h / droop_time))
        else:
            s[3] = target
        if q[LAG] > 0.0:
            seen = 0.5 * (p + p1)
            if q[LAG_BEFORE] > 0.0:
                before = s[5]
                s[5] += (seen - s[5]) * (1.0 - math.exp(-h / q[LAG_BEFORE]))
                seen = 0.5 * (before + s[5])
            s[2] += (seen - s[2]) * (1.0 - math.exp(-h / q[LAG]))
        else:
            s[2] = p1
        s[0] = max(p1, -0.99 * at)
        s[1] = iso
        v = v_next
        left -= h


@inlined
def _trial(
    q: Any, time: Any, reading: Any, length: Any, supply: Any, edge_s: Any, edge_to: Any,
    edge_of: Any, out: Any, fall: Any, due: Any, waiting: Any, opened: Any, command: Any, s: Any,
    step: Any, acting: Any, mode: int,
) -> None:  # fmt: skip
    """Predict the reading at every node of one trial into `out`.

    `due` to `s` are scratch; `step` and `acting` are left alone where the reading is followed.
    """
    waiting[:] = 0
    opened[:] = False
    command[:] = 0.0
    s[:] = 0.0
    true = (reading[0] - q[ZERO]) / (1.0 + q[GAIN])
    s[0] = max(true, -0.9 * q[ATMOSPHERE])
    s[1] = s[0]
    s[2] = s[0]
    s[4] = s[0]
    s[5] = s[0]
    edge = 0
    now = time[0]
    acts = now - 1.0
    out[0] = reading[0]
    # Commands from before the first reading have long acted.
    while edge < len(edge_s) and edge_s[edge] + q[CLOCK] <= now - 0.05:
        command[edge_of[edge]] = edge_to[edge]
        opened[edge_of[edge]] = edge_to[edge] > 0.5
        edge += 1
    for i in range(1, len(time)):
        end = time[i]
        begin = time[i - 1]
        v_begin = _braid_volume(length[i - 1], q[BRAID], q[TURNS]) + q[VOLUME]
        v_end = _braid_volume(length[i], q[BRAID], q[TURNS]) + q[VOLUME]
        slope = (v_end - v_begin) / (end - begin)
        feed = supply[i] + q[SUPPLY_SHIFT]
        busy = opened[0] or opened[1] or begin < acts
        while now < end:
            until = end
            what = -1
            if edge < len(edge_s) and edge_s[edge] + q[CLOCK] < until:
                until = max(now, edge_s[edge] + q[CLOCK])
                what = 2
            for w in range(2):
                if waiting[w] > 0 and due[w, 0] < until:
                    until = max(now, due[w, 0])
                    what = w
            if until > now:
                _advance(
                    q, s, until - now, v_begin + slope * (now - begin),
                    v_begin + slope * (until - begin), feed, opened[0], opened[1],
                )  # fmt: skip
                if s[3] > fall[0]:
                    fall[0] = s[3]
                now = until
            if what == 2:
                w = edge_of[edge]
                value = edge_to[edge]
                edge += 1
                busy = True
                acts = now + ACTS_S
                if value != command[w]:
                    command[w] = value
                    if q[TRANSPORT] == 0.0 and waiting[w] > 0:
                        waiting[w] = 0
                    elif waiting[w] < _PENDING:
                        which = 2 * w + (0 if value > 0.5 else 1)
                        upstream = feed if w == 0 else s[0]
                        delay = q[DELAY + which] + q[DELAY_SLOPE + which] * upstream
                        at = now + max(delay, 0.0)
                        if waiting[w] > 0:
                            at = max(at, due[w, waiting[w] - 1])
                        due[w, waiting[w]] = at
                        waiting[w] += 1
            elif what >= 0:
                opened[what] = not opened[what]
                busy = True
                acts = now + ACTS_S
                waiting[what] -= 1
                for j in range(waiting[what]):
                    due[what, j] = due[what, j + 1]
        shown = s[2] * (1.0 + q[GAIN]) + q[ZERO]
        out[i] = shown
        if mode != _FOLLOW:
            if mode == _LEARN:
                step[i] = reading[i] - shown
                acting[i] = 1.0 if busy else 0.0
            out[i] = shown + step[i]
            pull = step[i] / (1.0 + q[GAIN])
            if pull != 0.0:
                s[0] = max(s[0] + pull, -0.95 * q[ATMOSPHERE])
                s[1] = max(s[1] + pull, -0.95 * q[ATMOSPHERE])
                s[2] += pull
                s[5] += pull
        elif q[FOLLOW] > 0.0:
            pull = (reading[i] - shown) * (1.0 - math.exp(-(end - begin) / q[FOLLOW]))
            s[0] = max(s[0] + pull, -0.95 * q[ATMOSPHERE])
            s[1] = max(s[1] + pull, -0.95 * q[ATMOSPHERE])
            s[2] += pull
            s[5] += pull


def _build(sources: int) -> tuple[Callable[..., None], Callable[..., None]]:
    vector = "float64[::1]"
    whole = "int64[::1]"
    taken = (
        f"{vector}, {whole}, {vector}, {vector}, {vector}, {vector}, {whole}, {vector}, "
        f"{vector}, {whole}, {vector}"
    )

    # `sources` is used so that it becomes a closure variable; it is never negative.
    @entry_point(f"void({taken}, {vector})")
    def run(
        q: Any, first: Any, time: Any, reading: Any, length: Any, supply: Any, first_edge: Any,
        edge_s: Any, edge_to: Any, edge_of: Any, out: Any, fall: Any,
    ) -> None:  # fmt: skip
        if sources < 0:
            return
        fall[0] = 0.0
        due = np.empty((2, _PENDING))
        waiting = np.zeros(2, dtype=np.int64)
        opened = np.zeros(2, dtype=np.bool_)
        command = np.zeros(2)
        s = np.zeros(6)
        for t in range(len(first) - 1):
            a = first[t]
            b = first[t + 1]
            c = first_edge[t]
            d = first_edge[t + 1]
            if b > a:
                _trial(
                    q, time[a:b], reading[a:b], length[a:b], supply[a:b], edge_s[c:d],
                    edge_to[c:d], edge_of[c:d], out[a:b], fall, due, waiting, opened, command, s,
                    fall, fall, _FOLLOW,
                )  # fmt: skip

    @entry_point(f"void({taken}, {vector}, {vector}, boolean)")
    def free(
        q: Any, first: Any, time: Any, reading: Any, length: Any, supply: Any, first_edge: Any,
        edge_s: Any, edge_to: Any, edge_of: Any, out: Any, step: Any, acting: Any, learn: bool,
    ) -> None:  # fmt: skip
        if sources < 0:
            return
        fall = np.zeros(1)
        due = np.empty((2, _PENDING))
        waiting = np.zeros(2, dtype=np.int64)
        opened = np.zeros(2, dtype=np.bool_)
        command = np.zeros(2)
        s = np.zeros(6)
        for t in range(len(first) - 1):
            a = first[t]
            b = first[t + 1]
            c = first_edge[t]
            d = first_edge[t + 1]
            if b > a:
                _trial(
                    q, time[a:b], reading[a:b], length[a:b], supply[a:b], edge_s[c:d],
                    edge_to[c:d], edge_of[c:d], out[a:b], fall, due, waiting, opened, command, s,
                    step[a:b], acting[a:b], _LEARN if learn else _APPLY,
                )  # fmt: skip

    return run, free


predict, replay = _build(fingerprint())
"""`predict(q, first, time, reading, length, supply, first_edge, edge_s, edge_to, edge_of, out,
fall)`: all trials one after the other; nodes of trial t are `first[t]:first[t+1]`, likewise its
edges. SI throughout; `out` gets the predicted readings, `fall[0]` the largest fall of supply.

`replay(..., out, step, acting, learn)` takes the same. With `learn` the steps that the real gas
took beyond the model go to `step` (Pa, one a node), and `acting` says (1 or 0) whether a valve may
have been open since the node before; without it `step` is applied as it stands. `out` gets the
pressures as the gauge would read them."""
