"""Compiled simulation of a scene: valve commands of all units, their delays, and the mechanism.

The valves are those of the single bench (`plant.simulator.valves`), one per row, with the same
queue and delays. Importing this module loads numba; the first import after an installation
compiles.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from plant.arrays import Array
from plant.compiled import called, entry_point, fingerprint, inlined
from plant.physics import layout as at
from plant.scene import layout as sc
from plant.scene.events import first_event, log, log_switches, settle
from plant.scene.layout import Ints, World
from plant.scene.rates import gas_volume, remember, unit_force
from plant.scene.stepping import length_at, substep, touches, trial
from plant.simulator.rates import lagged, lasting, power
from plant.simulator.stepping import _accept, _book_regulated, _remember
from plant.simulator.valves import SAME_INSTANT_S, act, command, due_at

_TRIES = 12
_SHORTEST = 1e-9
_A2 = "float64[:,::1]"
_WORLD = (
    f"{_A2},{_A2},int64[::1],{_A2},{_A2},{_A2},{_A2},{_A2},float64[::1],float64[:,:,:,::1],"
    f"float64[:,:,::1],{_A2},{_A2},{_A2},float64[::1],{_A2},{_A2},{_A2}"
)


@inlined
def _take(w: World, begin: float, step: float) -> None:
    """Accept the last trial substep."""
    log_switches(w, begin, step)
    n = w.coords.shape[0]
    for k in range(w.units.shape[0]):
        state, params = w.units[k], w.params[k]
        length = length_at(w, k, sc.Q)
        how = w.work[sc.OPEN, k]
        if how == sc.REGULATED:
            p = lagged(state, params, state[at.PRESSURE], step)
            _book_regulated(state, params, p, length)
        elif how == sc.LEVEL:
            p = state[at.PRESSURE]
            _book_regulated(state, params, p, length)
        else:
            volume = gas_volume(w, k, length)
            p = w.work[sc.Y, k] / power(volume, params[at.EXPONENT]) - params[at.ATMOSPHERE]
            state[at.MASS_IN] += w.work[sc.IN, k]
            state[at.MASS_OUT] += w.work[sc.OUT, k]
        if w.shape[k, sc.MEMORY_KIND] != sc.NO_MEMORY:
            remember(w, k, p, length, step)
        follows = params[at.REMEMBERS] != 0.0
        p0 = state[at.PRESSURE]
        pull0 = lasting(state, params, p0, state[at.LENGTH]) if follows else 0.0
        _accept(state, params, p, length)
        if follows:
            _remember(state, params, p0, pull0, step)
    for j in range(n):
        w.motion[sc.PLACE, j] = w.work[sc.Q, j]
        w.motion[sc.RATE, j] = w.work[sc.QD, j]
        w.motion[sc.PUSH, j] = w.work[sc.TORQUE, j]
    settle(w, begin + step)


@called
def _integrate(w: World, begin: float, duration: float) -> None:
    """Advance gas and mechanism by `duration` seconds with constant valve positions."""
    done = 0.0
    while done < duration:
        now = begin + done
        # Equal parts of the remaining time, to avoid a very short last step.
        left = duration - done
        step = left / max(1, math.ceil(left / substep(w, now, touches(w)) - 1e-9))
        if w.coords.shape[0] == 0:
            idle = True
            for k in range(w.units.shape[0]):
                how = w.work[sc.OPEN, k]
                still = how == sc.SEALED or how == sc.LEVEL
                follows = w.params[k, at.REMEMBERS] != 0.0
                follows = follows or w.shape[k, sc.MEMORY_KIND] == sc.LATE
                idle = idle and still and not follows
            if idle:
                return
        for _ in range(_TRIES):
            trial(w, now, step)
            w.clock[sc.SUBSTEPS] += 1.0
            share = first_event(w)
            if share >= 1.0 or step < _SHORTEST:
                break
            step = max(step * share, 0.5 * _SHORTEST)
        _take(w, now, step)
        done = duration if step == left else done + step


@called
def _run_until(w: World, end: float) -> None:
    """Advance to `end` without new commands; pending valve edges act exactly at their time."""
    while True:
        due = math.inf
        unit = solenoid = 0
        for k in range(w.units.shape[0]):
            for which in range(2):
                own = due_at(w.units[k], which)
                if own < due:
                    due, unit, solenoid = own, k, which
        # An edge due exactly at `end` waits, because a command at `end` can still cancel it.
        acts = due < end - SAME_INSTANT_S
        until = due if acts else end
        now = w.units[0, at.TIME]
        if until > now:
            _integrate(w, now, until - now)
            for k in range(w.units.shape[0]):
                w.units[k, at.TIME] = until
        if not acts:
            break
        act(w.units[unit], w.params[unit], solenoid)
        opened = w.units[unit, at.INLET_OPEN + solenoid]
        log(w, due, float(sc.LOG_INLET + solenoid), float(unit), opened)


@inlined
def _measure(w: World) -> None:
    """Update force and speed of each unit."""
    for k in range(w.units.shape[0]):
        state = w.units[k]
        speed = 0.0
        for j in range(w.coords.shape[0]):
            speed += w.reach[k, j] * w.motion[sc.RATE, j]
        state[at.LENGTH_RATE] = speed
        state[at.FORCE] = unit_force(w, k, state[at.PRESSURE], state[at.LENGTH], speed)


@inlined
def _tick(w: World, dt_s: float, inlet_on_s: Array, vent_on_s: Array) -> None:
    """One control tick of every unit; see `plant.scene.scene.Scene.advance`."""
    units = w.units.shape[0]
    begin = w.units[0, at.TIME]
    for k in range(units):
        command(w.units[k], w.params[k], 0, 1.0 if inlet_on_s[k] > 0.0 else 0.0)
        command(w.units[k], w.params[k], 1, 1.0 if vent_on_s[k] > 0.0 else 0.0)
    last = 0.0
    while True:
        ends = math.inf
        for k in range(units):
            for on_s in (inlet_on_s[k], vent_on_s[k]):
                if last < on_s < dt_s - SAME_INSTANT_S:
                    ends = min(ends, on_s)
        if ends == math.inf:
            break
        _run_until(w, begin + ends)
        for k in range(units):
            if inlet_on_s[k] == ends:
                command(w.units[k], w.params[k], 0, 0.0)
            if vent_on_s[k] == ends:
                command(w.units[k], w.params[k], 1, 0.0)
        last = ends
    _run_until(w, begin + dt_s)
    _measure(w)


@inlined
def _replay(
    w: World, event_s: Array, unit: Ints, channel: Ints, value: Array, sample_s: Array, out: Array
) -> None:
    """Apply timed inputs and fill one row of `out` per sample time.

    Columns: pressure, length, force, inlet and outlet of each unit, then positions and rates of the
    coordinates.
    """
    event = 0
    units, n = w.units.shape[0], w.coords.shape[0]
    for row in range(sample_s.shape[0]):
        while event < event_s.shape[0] and event_s[event] <= sample_s[row]:
            _run_until(w, event_s[event])
            k = unit[event]
            if channel[event] <= at.CHANNEL_OUTLET:
                command(w.units[k], w.params[k], channel[event], value[event])
            elif channel[event] == at.CHANNEL_REGULATOR:
                w.units[k, at.REGULATOR_SET] = value[event]
            elif channel[event] == at.CHANNEL_SUPPLY:
                w.units[k, at.SUPPLY] = value[event]
            else:
                w.coords[k, sc.PULL] = value[event]
            event += 1
        _run_until(w, sample_s[row])
        _measure(w)
        for k in range(units):
            out[row, 5 * k] = w.units[k, at.PRESSURE]
            out[row, 5 * k + 1] = w.units[k, at.LENGTH]
            out[row, 5 * k + 2] = w.units[k, at.FORCE]
            out[row, 5 * k + 3] = w.units[k, at.INLET_OPEN]
            out[row, 5 * k + 4] = w.units[k, at.OUTLET_OPEN]
        for j in range(n):
            out[row, 5 * units + j] = w.motion[sc.PLACE, j]
            out[row, 5 * units + n + j] = w.motion[sc.RATE, j]


def _build(sources: int) -> Callable[..., None]:
    # One entry point for both uses, because a second one would compile the whole scene again.
    @entry_point(
        f"void({_WORLD},float64,float64[::1],float64[::1],"
        f"float64[::1],int64[::1],int64[::1],float64[::1],float64[::1],{_A2})"
    )
    def drive(
        a: Any, b: Any, c: Any, d: Any, e: Any, f: Any, g: Any, h: Any, i: Any, j: Any,
        k: Any, m: Any, n: Any, o: Any, p: Any, q: Any, r: Any, s: Any,
        dt_s: float, inlet_on_s: Any, vent_on_s: Any,
        event_s: Any, unit: Any, channel: Any, value: Any, sample_s: Any, out: Any,
    ) -> None:  # fmt: skip
        if sources >= 0:
            world = World(a, b, c, d, e, f, g, h, i, j, k, m, n, o, p, q, r, s)
            if dt_s >= 0.0:
                _tick(world, dt_s, inlet_on_s, vent_on_s)
            else:
                _replay(world, event_s, unit, channel, value, sample_s, out)

    return drive


_drive = _build(fingerprint("simulator", "scene", "links/kernel.py"))
_NONE = np.zeros(0)
_NO_ROWS = (np.zeros(0), np.zeros(0, np.int64), np.zeros(0, np.int64), *np.zeros((2, 0)),
            np.zeros((0, 0)))  # fmt: skip


def advance(world: World, dt_s: float, inlet_on_s: Array, vent_on_s: Array) -> None:
    """One control tick, in place; see `plant.scene.scene.Scene.advance`. Arrays have shape (M,)."""
    _drive(*world, dt_s, inlet_on_s, vent_on_s, *_NO_ROWS)


def replay(
    world: World,
    event_s: Array,
    unit: Ints,
    channel: Ints,
    value: Array,
    sample_s: Array,
    out: Array,
) -> None:
    """Simulate a recording of timed inputs, in place; see `_replay` for the columns of `out`."""
    _drive(*world, -1.0, _NONE, _NONE, event_s, unit, channel, value, sample_s, out)
