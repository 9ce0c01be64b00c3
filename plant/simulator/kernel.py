"""The bench in compiled code: valve commands and their delays, one state array stepped in place.

Importing this module loads numba and, the first time after an installation, compiles.
"""

from __future__ import annotations

from collections.abc import Callable

from plant.compiled import Slots, called, entry_point, fingerprint, inlined
from plant.physics import layout as at
from plant.physics import valve
from plant.simulator.rates import tension
from plant.simulator.stepping import integrate
from plant.simulator.valves import SAME_INSTANT_S, act, command, due_at

STATE = "float64[::1]"


_following = inlined(valve.following)


@called
def _moving(state: Slots, params: Slots, duration: float) -> None:
    """Advance gas and load while the valves come to the openings that they set out for."""
    lag = params[at.SPOOL_LAG]
    left = duration
    while left > 0.0:
        inlet, outlet = state[at.INLET_OPEN], state[at.OUTLET_OPEN]
        if lag == 0.0 or (inlet == state[at.SPOOL] and outlet == state[at.SPOOL + 1]):
            integrate(state, params, left)
            return
        step = min(left, valve.SPOOL_STEP * lag)
        state[at.INLET_OPEN], inlet = _following(inlet, state[at.SPOOL], step, lag)
        state[at.OUTLET_OPEN], outlet = _following(outlet, state[at.SPOOL + 1], step, lag)
        integrate(state, params, step)
        state[at.INLET_OPEN], state[at.OUTLET_OPEN] = inlet, outlet
        left -= step


@called
def run_until(state: Slots, params: Slots, end: float) -> None:
    """Advance to time `end` with no new command; pending valve edges act exactly when due."""
    while True:
        inlet_due = due_at(state, 0)
        outlet_due = due_at(state, 1)
        due = min(inlet_due, outlet_due)
        # An edge due at `end` itself waits: a command given there may still withdraw it.
        if due >= end - SAME_INSTANT_S:
            break
        if due > state[at.TIME]:
            _moving(state, params, due - state[at.TIME])
            state[at.TIME] = due
        act(state, params, 0 if inlet_due <= outlet_due else 1)
    if end > state[at.TIME]:
        _moving(state, params, end - state[at.TIME])
        state[at.TIME] = end


@inlined
def measure(state: Slots, params: Slots) -> None:
    """Put the force of the present state into it."""
    p, length, rate = state[at.PRESSURE], state[at.LENGTH], state[at.LENGTH_RATE]
    state[at.FORCE] = tension(state, params, p, length, rate)


@inlined
def _tick(state: Slots, params: Slots, dt_s: float, inlet_on_s: float, vent_on_s: float) -> None:
    """One control tick; see `plant.simulator.bench.advance`."""
    begin = state[at.TIME]
    command(state, params, 0, 1.0 if inlet_on_s > 0.0 else 0.0)
    command(state, params, 1, 1.0 if vent_on_s > 0.0 else 0.0)
    for turn in range(2):
        on_s = min(inlet_on_s, vent_on_s) if turn == 0 else max(inlet_on_s, vent_on_s)
        if 0.0 < on_s < dt_s - SAME_INSTANT_S:
            run_until(state, params, begin + on_s)
            if inlet_on_s == on_s:
                command(state, params, 0, 0.0)
            if vent_on_s == on_s:
                command(state, params, 1, 0.0)
    run_until(state, params, begin + dt_s)
    measure(state, params)


def _build(sources: int) -> Callable[..., None]:
    # `sources` is used so that it becomes a closure variable; it is never negative.
    @entry_point(f"void({STATE}, {STATE}, float64, float64, float64)")
    def advance(
        state: Slots, params: Slots, dt_s: float, inlet_on_s: float, vent_on_s: float
    ) -> None:
        if sources >= 0:
            _tick(state, params, dt_s, inlet_on_s, vent_on_s)

    return advance


advance = _build(fingerprint("simulator"))
"""Compiled entry point: one control tick. `plant.simulator.replay` has that for a recording."""
