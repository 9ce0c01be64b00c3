"""A whole recording in one compiled call: timed inputs, and a row of the state per sample time.

Apart from `plant.simulator.kernel`, so that a bench that only steps does not compile it. Importing
this module loads numba and, the first time after an installation, compiles.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from plant.compiled import Slots, entry_point, fingerprint, inlined
from plant.physics import layout as at
from plant.simulator.kernel import STATE, measure, run_until
from plant.simulator.valves import command


@inlined
def _replay(
    state: Slots, params: Slots, event_s: Any, channel: Any, value: Any, sample_s: Any, traces: Any
) -> None:
    """Apply timed inputs and fill one row of `traces` per sample time; both times ascending."""
    event = 0
    for row in range(sample_s.shape[0]):
        while event < event_s.shape[0] and event_s[event] <= sample_s[row]:
            run_until(state, params, event_s[event])
            if channel[event] <= at.CHANNEL_OUTLET:
                command(state, params, channel[event], value[event])
            elif channel[event] == at.CHANNEL_LENGTH_RATE:
                state[at.LENGTH_RATE] = value[event]
            elif channel[event] == at.CHANNEL_REGULATOR:
                state[at.REGULATOR_SET] = value[event]
            else:
                state[at.SUPPLY] = value[event]
            event += 1
        run_until(state, params, sample_s[row])
        measure(state, params)
        for column in range(traces.shape[1]):
            traces[row, column] = state[column]


def _build(sources: int) -> Callable[..., None]:
    # `sources` is used so that it becomes a closure variable; it is never negative.
    @entry_point(f"void({STATE}, {STATE}, {STATE}, int64[::1], {STATE}, {STATE}, float64[:, ::1])")
    def run(
        state: Slots,
        params: Slots,
        event_s: Any,
        channel: Any,
        value: Any,
        sample_s: Any,
        traces: Any,
    ) -> None:
        if sources >= 0:
            _replay(state, params, event_s, channel, value, sample_s, traces)

    return run


run = _build(fingerprint("simulator"))
"""Compiled entry point; see `plant.simulator.simulate`."""
