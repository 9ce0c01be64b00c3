"""Compiled valve edges and control ticks of a finger; see `stepping` for the time between edges.

Each muscle is a row in the layout of the one-muscle bench (`plant.physics.layout`), so valves, flow
and muscle laws are those of `plant.simulator.kernel` and `plant.simulator.rates`. Pending valve
edges of all muscles act exactly at their time.

Importing this module loads numba; the first import after an installation compiles.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from plant.arrays import Array
from plant.compiled import called, entry_point, fingerprint
from plant.finger.stepping import integrate, pull_of
from plant.links.layout import WORK
from plant.physics import layout as at
from plant.simulator.rates import chamber, power
from plant.simulator.valves import SAME_INSTANT_S, act, command, due_at


@called
def _run_until(
    muscles: Array,
    params: Array,
    tendons: Array,
    stops: Array,
    box: Any,
    end: float,
    step_max: float,
) -> bool:
    """Advance to time `end` without new commands; pending valve edges act exactly at their time."""
    m = muscles.shape[0]
    fine = True
    while True:
        due = math.inf
        which = 0
        for i in range(m):
            for valve in range(2):
                this = due_at(muscles[i], valve)
                if this < due:
                    due = this
                    which = 2 * i + valve
        stretch = min(due, end) - muscles[0, at.TIME]
        # An edge due exactly at `end` waits, because a command at `end` can still cancel it.
        last = due >= end - SAME_INSTANT_S
        if last:
            stretch = end - muscles[0, at.TIME]
        if stretch > 0.0:
            fine = fine and integrate(muscles, params, tendons, stops, box, stretch, step_max)
            for i in range(m):
                muscles[i, at.TIME] = end if last else due
        if last:
            return fine
        act(muscles[which // 2], params[which // 2], which % 2)


@called
def _tick(
    muscles: Array,
    params: Array,
    tendons: Array,
    stops: Array,
    box: Any,
    dt: float,
    step_max: float,
    on_s: Array,
) -> bool:
    """One control tick: muscle i fills for its first on_s[i, 0] s and vents for its first on_s[i,
    1] s.
    """
    m = muscles.shape[0]
    begin = muscles[0, at.TIME]
    fine = True
    for i in range(m):
        for valve in range(2):
            command(muscles[i], params[i], valve, 1.0 if on_s[i, valve] > 0.0 else 0.0)
    done = 0.0
    while True:
        following = dt
        for i in range(m):
            for valve in range(2):
                on = on_s[i, valve]
                if on > done and on < dt - SAME_INSTANT_S:
                    following = min(following, on)
        fine = fine and _run_until(
            muscles, params, tendons, stops, box, begin + following, step_max
        )
        if following == dt:
            return fine
        done = following
        for i in range(m):
            for valve in range(2):
                if on_s[i, valve] == done:
                    command(muscles[i], params[i], valve, 0.0)


@called
def _open(muscles: Array, params: Array, joints: Array, box: Any) -> None:
    """Set z from the muscles' rows and the joints."""
    n = box[0].shape[0]
    z = box[11]
    for i in range(2 * n):
        z[i] = joints[i]
    for i in range(muscles.shape[0]):
        absolute = muscles[i, at.PRESSURE] + params[i, at.ATMOSPHERE]
        volume = chamber(params[i], muscles[i, at.LENGTH])
        z[2 * n + i] = absolute * power(volume, params[i, at.EXPONENT])


@called
def _close(muscles: Array, params: Array, joints: Array, box: Any) -> None:
    """Write joint states and muscle forces back to the caller's arrays."""
    n = box[0].shape[0]
    z = box[11]
    for i in range(2 * n):
        joints[i] = z[i]
    for i in range(muscles.shape[0]):
        state = muscles[i]
        rate = state[at.LENGTH_RATE]
        state[at.FORCE] = pull_of(state, params[i], state[at.PRESSURE], state[at.LENGTH], rate)


_CONTENT = fingerprint("simulator", "finger", "links/kernel.py")
_TABLE = "float64[:,::1]"


def _build(content: int) -> Callable[..., bool]:
    # Using `content` makes it a closure variable; it is never negative.
    @entry_point(
        f"boolean({_TABLE},{_TABLE},float64[::1],{_TABLE},{_TABLE},{_TABLE},float64[::1],"
        f"float64,float64,float64[:,:,::1],{_TABLE})"
    )
    def advance(
        muscles: Array,
        params: Array,
        joints: Array,
        tendons: Array,
        stops: Array,
        table: Array,
        gravity: Array,
        dt: float,
        step_max: float,
        on_s: Array,
        traces: Array,
    ) -> bool:
        n = table.shape[0]
        m = muscles.shape[0] if content >= 0 else 0
        size = 2 * n + m
        # Work space for the whole call, because the functions below must not allocate.
        box = (
            table,
            gravity,
            np.zeros((n, WORK)),
            np.zeros((n, n)),
            np.zeros(n),
            np.zeros(n),
            np.zeros(n),
            np.zeros(m),
            np.zeros(n),
            np.zeros((n, n)),
            np.zeros((n, n)),
            np.zeros(size),
            np.zeros(size),
            np.zeros(size),
            np.zeros((4, size)),
            np.zeros(size),
        )
        _open(muscles, params, joints, box)
        z = box[11]
        fine = True
        for tick in range(on_s.shape[0]):
            fine = fine and _tick(muscles, params, tendons, stops, box, dt, step_max, on_s[tick])
            if tick < traces.shape[0]:
                for i in range(2 * n):
                    traces[tick, i] = z[i]
                for i in range(muscles.shape[0]):
                    traces[tick, 2 * n + i] = muscles[i, at.PRESSURE]
        _close(muscles, params, joints, box)
        return fine

    return advance


advance = _build(_CONTENT)
"""Runs control ticks; see `plant.finger.sim`. False if the inertia matrix became singular."""
