"""The pressure stage: commands, supply and measured length in, predicted pressure reading out.

The physics is that of docs/reference/plant.md; what differs from the simulator is that
it follows the measurement from afar: the prediction is drawn towards the reading with a time
constant of seconds, so that one cause early in a trial does not drown what comes after it, while
everything quicker, and every steady drift, stays in the residual. Whole data sets run in one
compiled call, which is what lets the diagnosis try a hundred candidate effects in a second.

`replay` runs free of the measurement instead. What the real gas did beyond the model is kept as one
small step of pressure for each node: what the reading gains over the model sent off from the
reading one node before. Summed up these steps are the measured pressure itself, never a slope of
it: a replay without any of them is the model alone, one with all of them the measurement again.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from gap.effects.terms import OF_TRIAL, Active, terms
from gap.model.threads import cores, each
from plant.arrays import Array
from plant.compiled import called, entry_point, fingerprint, inlined
from plant.constants import (
    GAS_CONSTANT_J_KG_K,
    REFERENCE_DENSITY_KG_M3,
    REFERENCE_TEMPERATURE_K,
    PlantConstants,
)
from plant.effects import pressure_stage as stage
from plant.effects.reference import FULL_PRESSURE_PA
from plant.physics import flow, layout, muscle, valve
from plant.physics.lag import at_pressure, follow
from plant.physics.layout import nominal_slots

FOLLOW_S = 5.0
"""Time constant with which the prediction is drawn towards the reading."""
_MOST_RATIO = 0.95

_factor = inlined(flow.subsonic_factor)
_outward = called(flow.outward_drive)
_drooped = called(flow.drooped)
_inlet_behind = called(flow.inlet_behind)
_with_index = inlined(flow.with_index)
_braid_volume = inlined(muscle.braid_volume)
_follow = inlined(follow)
_lag = inlined(at_pressure)
_opening = inlined(valve.opening)
_following = inlined(valve.following)
_PENDING = 256
_STATED_DROP_PA = 1e5
_LEAST_DROP_PA = 300.0
"""Drop over an orifice below which its flow is laminar."""
_FOLLOW, _LEARN, _APPLY, _PUSH = 0, 1, 2, 3
ACTS_S = 0.03
"""Seconds after a command's edge in which a valve may still move."""


def parameters(
    c: PlantConstants, active: Active, stated_supply_pa: float, trials: int = 0
) -> Array:
    """Parameter array of the stage, by the slots of `plant.effects.pressure_stage`.

    Args:
        stated_supply_pa: supply of the constants that the data set states.
        trials: number of trials; needed where an effect acts in one alone.
    """
    own = any(OF_TRIAL in shape for _, _, _, shape in active)
    q = np.zeros(stage.SIZE + (trials if own else 0))
    for slot, value in nominal_slots(c).items():
        q[slot] = value
    q[stage.SUPPLY_SHIFT] = c.supply_pa - stated_supply_pa
    q[stage.FOLLOW] = FOLLOW_S
    for term in terms(active):
        if OF_TRIAL in term.shape:
            if term.diagnosis.gas_in_trial is not None:
                term.diagnosis.gas_in_trial(q, term.amount, int(term.shape[OF_TRIAL]))
        elif term.diagnosis.gas is not None:
            term.diagnosis.gas(q, term.amount, term.option, term.shape)
    for side in (layout.INLET_CRITICAL_RATIO, layout.OUTLET_CRITICAL_RATIO):
        q[side] = min(max(q[side], 0.0), _MOST_RATIO)
    return q


@inlined
def laminar_drop(absolute: float, outside: float) -> float:
    """What drives a laminar leak, Pa: the squares of both pressures differ.

    Stated so that the leak passes as much as a choked orifice of its conductance at 400 kPa gauge.
    """
    at = 4e5 + outside
    return at * (absolute * absolute - outside * outside) / (at * at - outside * outside)


@inlined
def _stiffening(most: float, within: float, p: float, at: float) -> float:
    """The same of a wall that takes up `most` m3 at last, most of it within a pressure in Pa."""
    soft = math.exp(-p / within)
    return float(most * (1.0 - soft + (p + at) / within * soft))


@inlined
def _widening(q: Any, p: float, at: float) -> float:
    """Volume by which a hose that widens seems larger, m3.

    That is the slope over p of (p + at) times the volume the hose has gained at p.
    """
    wide = q[stage.ELASTIC] * (2.0 * p + at)
    if q[stage.STIFFENING] != 0.0:
        wide += _stiffening(q[stage.STIFFENING], q[stage.STIFFENING_PA], p, at)
    if q[stage.STIFFENING_LATE] != 0.0:
        wide += _stiffening(q[stage.STIFFENING_LATE], q[stage.STIFFENING_LATE_PA], p, at)
    return float(wide)


@inlined
def _at_once(q: Any) -> bool:
    """Whether the supply falls with a power of the flow, and takes no time for it."""
    return bool(q[stage.DROOP_POWER] > 0.0 and q[stage.DROOP_TIME] == 0.0)


@inlined
def _fall(q: Any, followed: float, p: float, supply: float, inlet: float) -> float:
    """How far the supply is below what it is at rest, Pa: `followed` unless a power states it."""
    if not _at_once(q):
        return followed
    if inlet == 0.0:
        return 0.0
    source = supply + q[layout.ATMOSPHERE]
    at_inlet = _drooped(
        source, p + q[layout.ATMOSPHERE], q[stage.DROOP], q[layout.INLET_CRITICAL_RATIO],
        q[stage.DROOP_POWER],
    )  # fmt: skip
    return float(source - at_inlet)


@called
def _falling(q: Any, fall: float, inside: float, source: float, span: float) -> float:
    """Fall towards which that of a supply goes for `span` s, Pa; pressures absolute.

    The flow depends on where the fall ends, steeply near equal pressures: that is solved for.
    """
    droop = min(q[stage.DROOP], flow.MOST_DROOP * source)
    follows = 1.0 - math.exp(-span / q[stage.DROOP_TIME])
    # The fall ends at what stays of it and `follows` of the target: as behind a line from a source
    # that is lower by what stays.
    level = source - (1.0 - follows) * fall
    if inside >= level:
        return 0.0
    inlet = _inlet_behind(
        level, inside, follows * droop, source - droop, q[layout.INLET_CRITICAL_RATIO],
        q[stage.DROOP_POWER],
    )  # fmt: skip
    return float((level - inlet) / follows)


@inlined
def _swing(
    read: float, rate: float, seen: float, span: float, late: float, damping: float
) -> tuple[float, float]:
    """Reading and its rate after `span` s of a second-order gauge that `late` s trails a ramp.

    The exact solution for a pressure `seen` that stays: read'' = w^2 (seen - read) - 2 d w read',
    w = 2 d / late, d below 1.
    """
    d = min(damping, 0.999)
    w = 2.0 * d / late
    swings = w * math.sqrt(1.0 - d * d)
    left = math.exp(-d * w * span)
    c = math.cos(swings * span)
    s = math.sin(swings * span)
    off = read - seen
    after = left * (off * c + (rate + d * w * off) / swings * s)
    return seen + after, left * (rate * c - (w * w * off + d * w * rate) / swings * s)


@inlined
def _line_time(q: Any, drop: float) -> float:
    """Time in s in which a vessel behind a throttle follows, at `drop` Pa over the throttle.

    Through an orifice the flow goes with the root of the drop; the time is stated at 100 kPa. Where
    a check valve lets it fill past the throttle, it empties in another time.
    """
    time = q[stage.LINE_TIME]
    if drop < 0.0 and q[stage.LINE_EMPTIES] > 0.0:
        time *= q[stage.LINE_EMPTIES]
    if q[stage.LINE_ORIFICE] == 0.0:
        return float(time)
    return float(time * math.sqrt((abs(drop) + _LEAST_DROP_PA) / _STATED_DROP_PA))


@inlined
def _flows(
    q: Any, p: float, supply: float, inlet: float, outlet: float, fall: float, scale: float,
    more_in: float, more_out: float,
) -> tuple[float, float, float]:  # fmt: skip
    """Mass flow in, mass flow out (kg/s), and the inlet's flow as a share of choked flow.

    `inlet` and `outlet` are how far the valves are open, 0 to 1. `scale` is what conductance and
    absolute pressure are multiplied by, kg/m3; `more_in` and
    `more_out` are what something else adds to the flows of the valves, as a share of them.
    """
    absolute = p + q[layout.ATMOSPHERE]
    flow_in = 0.0
    flow_out = 0.0
    share = 0.0
    if inlet > 0.0 and supply - p > q[layout.CLOSING]:
        above = max(supply - fall, -0.9 * q[layout.ATMOSPHERE]) + q[layout.ATMOSPHERE]
        share = _factor(absolute / above, q[layout.INLET_CRITICAL_RATIO])
        if q[layout.SUBSONIC_INDEX] != 0.0:
            share = _with_index(share, q[layout.SUBSONIC_INDEX])
        wider = 1.0 + q[stage.INLET_DROP] * (supply - fall - p) / FULL_PRESSURE_PA
        wider += q[layout.RATIO] * min(absolute / above, 1.0)
        flow_in = scale * inlet * q[layout.INLET_CONDUCTANCE] * max(wider, 0.02) * above * share
        flow_in *= max(1.0 + more_in, 0.0)
    area = q[stage.LEAK]
    if outlet > 0.0 and (q[layout.CLOSING + 1] == 0.0 or p > q[layout.CLOSING + 1]):
        wider = 1.0 + q[stage.OUTLET_DROP] * p / FULL_PRESSURE_PA
        wider += q[layout.RATIO + 1] * min(q[layout.ATMOSPHERE] / absolute, 1.0)
        wider = max(wider, 0.02)
        area += outlet * q[layout.OUTLET_CONDUCTANCE] * wider * max(1.0 + more_out, 0.0)
    if area > 0.0:
        drive = _outward(absolute, q[layout.ATMOSPHERE], q[layout.OUTLET_CRITICAL_RATIO])
        if q[layout.SUBSONIC_INDEX] != 0.0 and drive > 0.0:
            drive = absolute * _with_index(drive / absolute, q[layout.SUBSONIC_INDEX])
        flow_out = scale * area * drive
    if q[stage.LEAK_LAMINAR] != 0.0:
        flow_out += scale * q[stage.LEAK_LAMINAR] * laminar_drop(absolute, q[layout.ATMOSPHERE])
    return flow_in, flow_out, share


_HEAT_AT_PA = 4e5
"""Absolute pressure at which the time is stated in which the gas takes the wall's temperature."""
_LONGEST_S = 2e-3
_LONGEST_SHUT_S = 2e-2
"""Longest steps, s, with a valve open and with both shut: a leak alone is slow."""
_LEVEL_PA = 10.0
"""Difference of the pressures of two vessels that counts as none."""
_FADES = 0.5
"""Part of what an exponent has above one that fades: it ends half way to isothermal, as nothing is
known of where it ends, and its amount is fitted anyway. No other value was tried."""
_LEAST_SHARE = 0.05
"""Share of the atmosphere below which no gas in a muscle is."""


@called
def _advance(
    q: Any, s: Any, span: float, v0: float, v1: float, supply: float, inlet: float, outlet: float,
    scale: float, more_in: float, more_out: float,
) -> None:  # fmt: skip
    """Move gas state s over `span` s.

    It is (pressure, isothermal pressure, reading, fall, line, pressure at the sensor, rate of the
    reading, pressure that a yielding hose has come after, time since a valve opened).
    """
    left = span
    v = v0
    slope = (v1 - v0) / span
    line_time = 1.0
    k = q[layout.EXPONENT]
    heat = GAS_CONSTANT_J_KG_K * q[layout.GAS_TEMPERATURE]
    at = q[layout.ATMOSPHERE]
    # Flow ends where the pressures are equal, or where too little holds the valve open.
    filled = supply - q[layout.CLOSING]
    vented = q[layout.CLOSING + 1]
    quiet = inlet == 0.0 and outlet == 0.0 and q[stage.LEAK] == 0.0 and q[stage.LEAK_LAMINAR] == 0.0
    quiet = quiet and q[stage.LINE] == 0.0 and q[stage.ELASTIC] == 0.0
    quiet = quiet and q[stage.STIFFENING] == 0.0 and q[stage.YIELDING] == 0.0
    hose = 0.0
    hose_next = 0.0
    swells = 0.0
    while left > 1e-12:
        if q[stage.FADING] > 0.0:
            faded = 1.0 - math.exp(-(s[8] + 0.5 * left) / q[stage.FADING])
            lasting = 1.0 - _FADES * faded
            k = 1.0 + (q[layout.EXPONENT] - 1.0) * lasting
        p = s[0]
        flow_in = 0.0
        flow_out = 0.0
        share = 0.0
        rate = 0.0
        h = left
        # Most of a record is quiet: nothing flows, and the gas follows the volume in one step.
        if not quiet:
            # Where one step ends the next begins, and a power takes as long as all the rest.
            fall = _fall(q, s[3], p, supply, inlet) if left == span else s[3]
            flow_in, flow_out, share = _flows(
                q, p, supply, inlet, outlet, fall, scale, more_in, more_out
            )
            warm = 1.0
            if q[stage.HEAT_BY_MASS] > 0.0 and flow_out > 0.0:
                # What leaves is as warm as what stays, and warm gas is thinner.
                warm = (p + at) / max(s[1] + at, _LEAST_SHARE * at)
                flow_out /= math.sqrt(warm)
            # A hose that widens takes gas as if the volume were larger by this much.
            wide = _widening(q, max(p, 0.0), at)
            if q[stage.YIELDING] > 0.0:
                hose = q[stage.YIELDING] * s[7]
                swells = q[stage.YIELDING] * (max(p, 0.0) - s[7]) / q[stage.YIELDING_TIME]
            rate = k * heat * (flow_in - warm * flow_out) / (v + hose + wide)
            rate -= k * (p + at) * (slope + swells) / (v + hose)
            # A step changes the pressure by a seventh of what drives the flow, at most. With a
            # third the end of a fill was off as if the valve had another subsonic index.
            drive = 1e9
            if inlet > 0.0:
                drive = abs(filled - fall - p) + 200.0
            if outlet > 0.0 or q[stage.LEAK] > 0.0:
                drive = min(drive, abs(p - vented) + 200.0)
            h = min(left, max(0.15 * drive / (abs(rate) + 1.0), 2e-5))
            h = min(h, _LONGEST_SHUT_S if inlet == 0.0 and outlet == 0.0 else _LONGEST_S)
            if q[stage.YIELDING] > 0.0:
                h = min(h, 0.3 * q[stage.YIELDING_TIME])
        if q[stage.LINE] > 0.0:
            line_time = _line_time(q, p - s[4])
            # Where both are level and stay so, what the one gives the other is exact for any step.
            level = abs(p - s[4]) < _LEVEL_PA and abs(rate) * line_time < _LEVEL_PA
            if not level or inlet > 0.0 or outlet > 0.0:
                h = min(h, 0.3 * line_time)
        if q[stage.DROOP_TIME] > 0.0 and inlet > 0.0:
            h = min(h, 0.3 * q[stage.DROOP_TIME])
        v_next = v + slope * h
        if quiet:
            squeezed = v / v_next
            iso = (s[1] + at) * squeezed - at
            p1 = p
            if slope != 0.0:
                # A power takes as long as all the rest of a step; isothermal gas needs none.
                p1 = (p + at) * (squeezed if k == 1.0 else squeezed**k) - at
        else:
            p_try = max(p + h * rate, -0.95 * at)
            fall = _fall(q, s[3], p_try, supply, inlet)
            in2, out2, share = _flows(
                q, p_try, supply, inlet, outlet, fall, scale, more_in, more_out
            )
            out2 /= math.sqrt(warm)
            wide = _widening(q, max(p_try, 0.0), at)
            if q[stage.YIELDING] > 0.0:
                follows = 1.0 - math.exp(-h / q[stage.YIELDING_TIME])
                s[7] += (0.5 * (max(p, 0.0) + max(p_try, 0.0)) - s[7]) * follows
                hose_next = q[stage.YIELDING] * s[7]
                swells = q[stage.YIELDING] * (max(p_try, 0.0) - s[7]) / q[stage.YIELDING_TIME]
            rate2 = k * heat * (in2 - warm * out2) / (v_next + hose_next + wide)
            rate2 -= k * (p_try + at) * (slope + swells) / (v_next + hose_next)
            p1 = p + 0.5 * h * (rate + rate2)
            mass = 0.5 * h * (flow_in - flow_out + in2 - out2)
            iso = ((s[1] + at) * (v + hose) + heat * mass) / (v_next + hose_next) - at
            # Flow ends at equal pressure; no step may carry the gas beyond.
            alone = slope == 0.0
            top = filled
            if not _at_once(q):
                top -= s[3]
            if inlet > 0.0 and outlet == 0.0 and p <= top and alone:
                p1 = min(p1, top)
            if outlet > 0.0 and inlet == 0.0 and alone:
                if p > vented or p == 0.0:
                    p1 = max(p1, vented if p > vented else 0.0)
                elif p < 0.0:
                    p1 = min(p1, 0.0)
        if q[stage.LINE] > 0.0:  # exactly what the one gives the other takes
            larger = 1.0 + q[stage.LINE] / v_next
            gone = (p1 - s[4]) * (1.0 - math.exp(-h * larger / line_time)) / larger
            s[4] += gone
            p1 -= (larger - 1.0) * gone
            iso -= (larger - 1.0) * gone
        if q[stage.HEAT_RATE] > 0.0:
            pace = q[stage.HEAT_RATE]
            if q[stage.HEAT_BY_MASS] > 0.0:
                pace *= _HEAT_AT_PA / max(iso + at, _LEAST_SHARE * at)
            p1 += (iso - p1) * (1.0 - math.exp(-h * pace))
        target = q[stage.DROOP] * share if inlet > 0.0 else 0.0
        if _at_once(q):
            target = _fall(q, 0.0, p1, supply, inlet)
        elif q[stage.DROOP_POWER] > 0.0 and inlet > 0.0:
            target = _falling(q, s[3], p1 + at, supply + at, h)
        droop_time = q[stage.DROOP_TIME]
        if target < s[3] and q[stage.DROOP_BACK] > 0.0:
            droop_time = q[stage.DROOP_BACK]
        if droop_time > 0.0:
            s[3] += (target - s[3]) * (1.0 - math.exp(-h / droop_time))
        else:
            s[3] = target
        if q[stage.LAG] > 0.0:
            seen = 0.5 * (p + p1)
            late = _lag(q[stage.LAG], q[stage.LAG_WITH_PRESSURE], seen + at)
            if q[stage.LAG_DAMPING] > 0.0:
                s[2], s[6] = _swing(s[2], s[6], seen, h, late, q[stage.LAG_DAMPING])
            elif q[stage.LAG_BEFORE] > 0.0:
                before = s[5]
                s[5] += (seen - s[5]) * (1.0 - math.exp(-h / q[stage.LAG_BEFORE]))
                seen = 0.5 * (before + s[5])
            if q[stage.LAG_DAMPING] == 0.0:
                s[2] += (seen - s[2]) * (1.0 - math.exp(-h / late))
        else:
            s[2] = p1
        s[0] = max(p1, -0.99 * at)
        s[1] = iso
        s[8] += h
        v = v_next
        left -= h


@inlined
def _trial(
    q: Any, time: Any, reading: Any, length: Any, supply: Any, edge_s: Any, edge_to: Any,
    edge_of: Any, out: Any, fall: Any, due: Any, told: Any, waiting: Any, opened: Any, spool: Any,
    command: Any, s: Any,
    step: Any, acting: Any, more: Any, mode: int,
) -> None:  # fmt: skip
    """Predict the reading at every node of one trial into `out`.

    A reading that is NaN draws nothing: nothing is known there. `due` to `s` are scratch; `step`
    and `acting` are left alone where the reading is followed; with `_PUSH` it is followed, and
    `step` is what something else has added to the pressure since the node before, `more` what it
    does to the valves, to the reading and to the supply, as in `Push`.
    """
    waiting[:] = 0
    opened[:] = 0.0
    spool[:] = 0.0
    command[:] = 0.0
    s[:] = 0.0
    true = 0.0  # vented, where the gauge is at its lower end
    if not math.isnan(reading[0]):
        wrong = more[6, 0] if mode == _PUSH else 0.0
        true = (reading[0] - wrong - q[stage.ZERO]) / (1.0 + q[stage.GAIN])
    s[0] = max(true, -0.9 * q[layout.ATMOSPHERE])
    s[1] = s[0]
    s[2] = s[0]
    s[4] = s[0]
    s[5] = s[0]
    s[7] = max(s[0], 0.0)
    s[8] = 1e3
    scale = REFERENCE_DENSITY_KG_M3 * math.sqrt(REFERENCE_TEMPERATURE_K / q[layout.GAS_TEMPERATURE])
    lag = q[layout.SPOOL_LAG]
    edge = 0
    now = time[0]
    acts = now - 1.0
    out[0] = reading[0]
    if math.isnan(reading[0]):
        out[0] = true * (1.0 + q[stage.GAIN]) + q[stage.ZERO]
    # Commands from before the first reading have long acted.
    while edge < len(edge_s) and edge_s[edge] + q[stage.CLOCK] <= now - 0.05:
        command[edge_of[edge]] = edge_to[edge]
        opened[edge_of[edge]] = _opening(edge_to[edge], q[layout.DEAD_BAND + edge_of[edge]])
        spool[edge_of[edge]] = opened[edge_of[edge]]
        edge += 1
    v_end = (
        _braid_volume(length[0], q[layout.BRAID_LENGTH], q[layout.TURNS]) + q[layout.DEAD_VOLUME]
    )
    paced = -1.0
    followed = 0.0
    for i in range(1, len(time)):
        end = time[i]
        begin = time[i - 1]
        v_begin = v_end
        v_end = (
            _braid_volume(length[i], q[layout.BRAID_LENGTH], q[layout.TURNS])
            + q[layout.DEAD_VOLUME]
        )
        slope = (v_end - v_begin) / (end - begin)
        feed = supply[i] + q[stage.SUPPLY_SHIFT]
        if mode == _PUSH:
            feed += more[7, i]
        busy = opened[0] > 0.0 or opened[1] > 0.0 or begin < acts
        more_in = more[0, i] if mode == _PUSH else 0.0
        more_out = more[1, i] if mode == _PUSH else 0.0
        while now < end:
            until = end
            what = -1
            if edge < len(edge_s) and edge_s[edge] + q[stage.CLOCK] < until:
                until = max(now, edge_s[edge] + q[stage.CLOCK])
                what = 2
            for w in range(2):
                if waiting[w] > 0 and due[w, 0] < until:
                    until = max(now, due[w, 0])
                    what = w
            while now < until:
                to = until
                inlet = opened[0]
                outlet = opened[1]
                if lag > 0.0 and (inlet != spool[0] or outlet != spool[1]):
                    to = min(until, now + valve.SPOOL_STEP * lag)
                    inlet, opened[0] = _following(opened[0], spool[0], to - now, lag)
                    outlet, opened[1] = _following(opened[1], spool[1], to - now, lag)
                    acts = to + ACTS_S
                _advance(
                    q, s, to - now, v_begin + slope * (now - begin),
                    v_begin + slope * (to - begin), feed, inlet, outlet, scale, more_in, more_out,
                )  # fmt: skip
                if s[3] > fall[0]:
                    fall[0] = s[3]
                now = to
            if what == 2:
                w = edge_of[edge]
                value = edge_to[edge]
                edge += 1
                busy = True
                acts = now + ACTS_S
                if value != command[w]:
                    which = 2 * w + (0 if value > command[w] else 1)
                    command[w] = value
                    if q[layout.DELAY_MODE] == 0.0 and waiting[w] > 0:
                        waiting[w] = 0
                    elif waiting[w] == _PENDING:
                        told[w, _PENDING - 1] = value
                    else:
                        upstream = feed if w == 0 else s[0]
                        delay = q[layout.DELAY + which] + q[layout.DELAY_SLOPE + which] * upstream
                        if mode == _PUSH:
                            delay += more[2 + which, i]
                        at = now + max(delay, 0.0)
                        if waiting[w] > 0:
                            at = max(at, due[w, waiting[w] - 1])
                        due[w, waiting[w]] = at
                        told[w, waiting[w]] = value
                        waiting[w] += 1
            elif what >= 0:
                before = spool[what]
                spool[what] = _opening(told[what, 0], q[layout.DEAD_BAND + what])
                if before == 0.0 and spool[what] > 0.0:
                    s[8] = 0.0
                if lag == 0.0:
                    opened[what] = spool[what]
                busy = True
                acts = now + ACTS_S
                waiting[what] -= 1
                for j in range(waiting[what]):
                    due[what, j] = due[what, j + 1]
                    told[what, j] = told[what, j + 1]
        if mode == _PUSH and step[i] != 0.0:
            s[0] = max(s[0] + step[i], -0.95 * q[layout.ATMOSPHERE])
            s[1] = max(s[1] + step[i], -0.95 * q[layout.ATMOSPHERE])
            if q[stage.LAG] == 0.0:
                s[2] += step[i]
        shown = s[2] * (1.0 + q[stage.GAIN]) + q[stage.ZERO]
        if mode == _PUSH:
            shown += more[6, i]
        out[i] = shown
        if mode in (_LEARN, _APPLY):
            if mode == _LEARN:
                step[i] = reading[i] - shown
                acting[i] = 1.0 if busy else 0.0
            out[i] = shown + step[i]
            pull = step[i] / (1.0 + q[stage.GAIN])
            if pull != 0.0:
                s[0] = max(s[0] + pull, -0.95 * q[layout.ATMOSPHERE])
                s[1] = max(s[1] + pull, -0.95 * q[layout.ATMOSPHERE])
                s[2] += pull
                s[5] += pull
        elif q[stage.FOLLOW] > 0.0 and not math.isnan(reading[i]):
            # Samples are evenly spaced over long stretches.
            if end - begin != paced:
                paced = end - begin
                followed = 1.0 - math.exp(-paced / q[stage.FOLLOW])
            pull = (reading[i] - shown) * followed
            s[0] = max(s[0] + pull, -0.95 * q[layout.ATMOSPHERE])
            s[1] = max(s[1] + pull, -0.95 * q[layout.ATMOSPHERE])
            s[2] += pull
            s[5] += pull


def _build(sources: int) -> Callable[..., None]:
    vector = "float64[::1]"
    whole = "int64[::1]"

    # `sources` is used so that it becomes a closure variable; it is never negative.
    @entry_point(
        f"void({vector}, {whole}, {vector}, {vector}, {vector}, {vector}, {whole}, {vector}, "
        f"{vector}, {whole}, {vector}, {vector}, {vector}, {vector}, float64[:, :], int64)",
        threads=True,
    )
    def run(
        q: Any, first: Any, time: Any, reading: Any, length: Any, supply: Any, first_edge: Any,
        edge_s: Any, edge_to: Any, edge_of: Any, out: Any, fall: Any, step: Any, acting: Any,
        more: Any, mode: int,
    ) -> None:  # fmt: skip
        if sources < 0:
            return
        fall[0] = 0.0
        due = np.empty((2, _PENDING))
        told = np.empty((2, _PENDING))
        waiting = np.zeros(2, dtype=np.int64)
        opened = np.zeros(2)
        spool = np.zeros(2)
        command = np.zeros(2)
        s = np.zeros(9)
        leak = q[stage.LEAK]
        for t in range(len(first) - 1):
            if len(q) > stage.SIZE:
                q[stage.LEAK] = leak + q[stage.LEAK_OF_TRIAL + t]
            a = first[t]
            b = first[t + 1]
            c = first_edge[t]
            d = first_edge[t + 1]
            if b > a:
                _trial(
                    q, time[a:b], reading[a:b], length[a:b], supply[a:b], edge_s[c:d],
                    edge_to[c:d], edge_of[c:d], out[a:b], fall, due, told, waiting, opened, spool,
                    command, s, step[a:b], acting[a:b], more[:, a:b], mode,
                )  # fmt: skip
        q[stage.LEAK] = leak

    return run


_run = _build(fingerprint())
_NONE = np.empty(0)
_NO_MORE = np.empty((8, 0))
_WORTH_THREADS = 10_000


@dataclass(frozen=True)
class Push:
    """What something else adds to the gas, at every node.

    Attributes:
        pressure: Pa since the node before, shape (nodes,).
        valves: to the flows of inlet and outlet since the node before, as a share of them; and to
            the delays with which the inlet opens and shuts, and the outlet, s; shape (6, nodes).
        reading: what the gauge shows too much, Pa, shape (nodes,).
        supply: what the supply is higher since the node before, Pa, shape (nodes,).
    """

    pressure: Array
    valves: Array
    reading: Array
    supply: Array

    def __add__(self, other: Push) -> Push:
        return Push(
            self.pressure + other.pressure,
            self.valves + other.valves,
            self.reading + other.reading,
            self.supply + other.supply,
        )


def predict(*arrays: Any, push: Push | None = None) -> None:
    """All trials one after the other, the prediction drawn towards the reading.

    Takes (q, first, time, reading, length, supply, first_edge, edge_s, edge_to, edge_of, out,
    fall): nodes of trial t are `first[t]:first[t+1]`, likewise its edges of commands; readings go
    to `out`, `fall[0]` is the largest fall of the supply. `push` is what something else adds.
    """
    step, more, mode = _NONE, _NO_MORE, _FOLLOW
    if push is not None:
        step, more, mode = push.pressure, np.vstack([push.valves, push.reading, push.supply]), _PUSH
    q, first, *nodes, first_edge, edge_s, edge_to, edge_of, out, fall = arrays

    def run(trials: slice) -> float:
        largest = np.zeros(1)
        _run(
            _of_trials(q, trials), first[trials], *nodes, first_edge[trials], edge_s, edge_to,
            edge_of, out, largest, step, _NONE, more, mode,
        )  # fmt: skip
        return float(largest[0])

    fall[0] = max(each(run, _parts(first)))


def _of_trials(q: Any, trials: slice) -> Any:
    """Parameters for some trials alone; a copy where trials have some of their own."""
    if len(q) == stage.SIZE:
        return q
    own = q[stage.LEAK_OF_TRIAL :][trials.start : trials.stop - 1]
    return np.concatenate([q[: stage.SIZE], own])


def _parts(first: Any) -> list[slice]:
    """Trials in parts with about as many nodes, one for each thread; one part where few."""
    nodes = int(first[-1])
    count = cores() if nodes > _WORTH_THREADS else 1
    wanted = [nodes * k // count for k in range(1, count)]
    ends = [0, *np.searchsorted(first, wanted).tolist(), len(first) - 1]
    return [slice(a, b + 1) for a, b in pairwise(ends) if b > a] or [slice(0, len(first))]


def replay(*arrays: Any, learn: bool) -> None:
    """All trials, running free of the reading, with the steps of the real gas put in.

    Takes the arrays of `predict` up to `out`, then step and acting. With `learn` the steps that the
    real gas took beyond the model go to `step` (Pa, one a node), and `acting` says (1 or 0) whether
    a valve may have been open since the node before; without it `step` is applied as it stands.
    `out` gets the pressures as the gauge would read them.
    """
    q, first, *common, step, acting = arrays
    everything = slice(0, len(first))
    _run(
        _of_trials(q, everything),
        first,
        *common,
        np.zeros(1),
        step,
        acting,
        _NO_MORE,
        _LEARN if learn else _APPLY,
    )


def perturbed(plain: Any, changed: Any, path: Any, *arrays: Any) -> Any:
    """The path of gas that something else has simulated, with what effects do to it.

    Takes constants and length without and with the effects, a pair each, without what the gauge
    does, the path, and the arrays of `predict` less readings, length and what is written to. The
    steps that the path takes beyond the model are kept: what an effect adds is that of the model,
    along the path.
    """
    first, time, supply, first_edge, edge_s, edge_to, edge_of = arrays
    step, acting, out = (np.empty(len(time)) for _ in range(3))

    def run(trials: slice) -> None:
        for (q, length), learn in ((plain, True), (changed, False)):
            replay(
                _of_trials(q, trials), first[trials], time, path, length, supply,
                first_edge[trials], edge_s, edge_to, edge_of, out, step, acting, learn=learn,
            )  # fmt: skip

    each(run, _parts(first))
    return out


def behind_lag(
    first: Any, time: Any, path: Any, lag_s: float, power: float, at: float, damping: float = 0.0
) -> Any:
    """What a lag shows of a path that is straight between its nodes, trial by trial.

    Args:
        power: of the absolute pressure, which the lag falls with.
        at: pressure of the atmosphere, Pa.
        damping: of a second-order lag; 0 for one of first order.
    """
    out = np.empty(len(time))
    _behind_lag(first, time, path, lag_s, power, at, damping, out)
    return out


def _build_lag(sources: int) -> Callable[..., None]:
    @entry_point(
        "void(int64[::1], float64[::1], float64[::1], float64, float64, float64, float64, "
        "float64[::1])"
    )
    def lag(
        first: Any, time: Any, path: Any, lag_s: float, power: float, at: float, damping: float,
        out: Any,
    ) -> None:  # fmt: skip
        if sources < 0:
            return
        for t in range(len(first) - 1):
            rate = 0.0
            for i in range(first[t], first[t + 1]):
                if i == first[t]:
                    out[i] = path[i]
                    continue
                h = time[i] - time[i - 1]
                middle = 0.5 * (path[i - 1] + path[i])
                late = _lag(lag_s, power, middle + at)
                if damping > 0.0:
                    out[i], rate = _swing(out[i - 1], rate, middle, h, late, damping)
                else:
                    out[i] = _follow(out[i - 1], path[i - 1], path[i], h, late)

    return lag


_behind_lag = _build_lag(fingerprint())
