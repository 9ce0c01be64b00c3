"""Commands to the two valves of a bench and their delays, in compiled code.

Apart from the entry points, so that a scene and a finger, which have the same valves, take them
without compiling the bench.
"""

from __future__ import annotations

import math

from plant.compiled import Slots, called, inlined
from plant.physics import layout as at
from plant.physics import valve

_opening = inlined(valve.opening)

SAME_INSTANT_S = 1e-9
"""A command withdrawn within this time of the valve acting on it is withdrawn in time."""


@called
def command(state: Slots, params: Slots, which: int, value: float) -> None:
    """Give valve `which` (0 inlet, 1 outlet) a command of 0 to 1 at the present time.

    The delay is taken from the pressure upstream of that solenoid at this moment.
    """
    before = state[at.INLET_COMMAND + which]
    if before == value:
        return
    state[at.INLET_COMMAND + which] = value
    count = int(state[at.QUEUE_COUNT + which])
    if params[at.DELAY_MODE] == 0.0 and count > 0:
        # Inertial: the valve had not yet acted on the command that is now withdrawn.
        state[at.QUEUE_COUNT + which] = 0.0
        return
    ring = at.QUEUE + which * at.QUEUE_LENGTH
    values = at.QUEUED + which * at.QUEUE_LENGTH
    head = int(state[at.QUEUE_HEAD + which])
    if count == at.QUEUE_LENGTH:
        # The command before it acts no more, what it is replaced by acts in its place.
        state[values + (head + count - 1) % at.QUEUE_LENGTH] = value
        state[at.EDGES_MERGED] += 1.0
        return
    upstream = state[at.SUPPLY] if which == 0 else state[at.PRESSURE]
    edge = 2 * which + (0 if value > before else 1)
    delay = params[at.DELAY + edge] + params[at.DELAY_SLOPE + edge] * upstream
    due = state[at.TIME] + max(0.0, delay)
    if count > 0:
        # Edges act in the order they were given; one never overtakes the edge before it.
        due = max(due, state[ring + (head + count - 1) % at.QUEUE_LENGTH])
    state[ring + (head + count) % at.QUEUE_LENGTH] = due
    state[values + (head + count) % at.QUEUE_LENGTH] = value
    state[at.QUEUE_COUNT + which] = count + 1.0


@inlined
def due_at(state: Slots, which: int) -> float:
    """Time at which the oldest pending edge of a solenoid acts; inf if none is pending."""
    if state[at.QUEUE_COUNT + which] == 0.0:
        return math.inf
    head = int(state[at.QUEUE_HEAD + which])
    return state[at.QUEUE + which * at.QUEUE_LENGTH + head]


@inlined
def act(state: Slots, params: Slots, which: int) -> None:
    """Let the oldest pending command of a valve act; behind a lag the valve only sets out."""
    head = int(state[at.QUEUE_HEAD + which])
    value = state[at.QUEUED + which * at.QUEUE_LENGTH + head]
    goal = _opening(value, params[at.DEAD_BAND + which])
    state[at.SPOOL + which] = goal
    if params[at.SPOOL_LAG] == 0.0:
        state[at.INLET_OPEN + which] = goal
    state[at.QUEUE_HEAD + which] = (head + 1) % at.QUEUE_LENGTH
    state[at.QUEUE_COUNT + which] -= 1.0
