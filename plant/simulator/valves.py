"""Commands to the two valves of a bench and their delays, in compiled code.

Apart from the entry points, so that a scene and a finger, which have the same valves, take them
without compiling the bench.
"""

from __future__ import annotations

import math

from plant.compiled import Slots, called, inlined
from plant.physics import layout as at

SAME_INSTANT_S = 1e-9
"""A command withdrawn within this time of the valve acting on it is withdrawn in time."""


@called
def command(state: Slots, params: Slots, which: int, value: float) -> None:
    """Give solenoid `which` (0 inlet, 1 outlet) a command at the present time.

    The delay is taken from the pressure upstream of that solenoid at this moment.
    """
    if state[at.INLET_COMMAND + which] == value:
        return
    state[at.INLET_COMMAND + which] = value
    count = int(state[at.QUEUE_COUNT + which])
    if params[at.DELAY_MODE] == 0.0 and count > 0:
        # Inertial: the valve had not yet acted on the command that is now withdrawn.
        state[at.QUEUE_COUNT + which] = 0.0
        return
    if count == at.QUEUE_LENGTH:
        state[at.QUEUE_COUNT + which] = count - 1.0
        state[at.EDGES_MERGED] += 1.0
        return
    upstream = state[at.SUPPLY] if which == 0 else state[at.PRESSURE]
    edge = 2 * which + (0 if value > 0.0 else 1)
    delay = params[at.DELAY + edge] + params[at.DELAY_SLOPE + edge] * upstream
    due = state[at.TIME] + max(0.0, delay)
    ring = at.QUEUE + which * at.QUEUE_LENGTH
    head = int(state[at.QUEUE_HEAD + which])
    if count > 0:
        # Edges act in the order they were given; one never overtakes the edge before it.
        due = max(due, state[ring + (head + count - 1) % at.QUEUE_LENGTH])
    state[ring + (head + count) % at.QUEUE_LENGTH] = due
    state[at.QUEUE_COUNT + which] = count + 1.0


@inlined
def due_at(state: Slots, which: int) -> float:
    """Time at which the oldest pending edge of a solenoid acts; inf if none is pending."""
    if state[at.QUEUE_COUNT + which] == 0.0:
        return math.inf
    head = int(state[at.QUEUE_HEAD + which])
    return state[at.QUEUE + which * at.QUEUE_LENGTH + head]


@inlined
def act(state: Slots, which: int) -> None:
    """Let the oldest pending edge of a solenoid act: edges alternate, so the valve toggles."""
    state[at.INLET_OPEN + which] = 1.0 - state[at.INLET_OPEN + which]
    state[at.QUEUE_HEAD + which] = (int(state[at.QUEUE_HEAD + which]) + 1) % at.QUEUE_LENGTH
    state[at.QUEUE_COUNT + which] -= 1.0
