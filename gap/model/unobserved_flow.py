"""Gas that went in or out unseen: what a load that bounces between frames leaves unknown.

While a valve is open the length decides how much gas passes, above all near the atmosphere, where
air goes out and in as the load bounces. What the frames did not show then stays in the muscle as an
amount of gas that nobody knows, and as one error of the pressure until the end of the trial.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from gap.data.trial import Trial
from gap.model.signals import edges_of
from plant.arrays import Array

_CLOSING_S = 0.03
"""Time after a command's end in which a valve may still pass air."""


def passing(trial: Trial, time_s: Array) -> npt.NDArray[np.bool_]:
    """Where a valve may pass air: from a command's start until the valve has surely shut."""
    edges, values, which = edges_of(trial)
    made = np.zeros(len(time_s), dtype=bool)
    for valve in (0, 1):
        at, on = edges[which == valve], values[which == valve] != 0.0
        if not len(at):
            continue
        last = np.searchsorted(at, time_s, side="right") - 1
        before = np.maximum(last, 0)
        made |= (last >= 0) & (on[before] | (time_s - at[before] < _CLOSING_S))
    return made


def unknown_gas(doubt: Array, gas: Array, open_now: npt.NDArray[np.bool_]) -> Array:
    """Share of the gas that is unknown because of what passed while nobody saw the length.

    Filling adds gas that is known; emptying takes its share of what is not.

    Args:
        doubt: relative doubt of the volume at each node, shape (nodes,).
        gas: amount of gas there, in any unit.
        open_now: where a valve may pass air.
    """
    made = np.zeros(len(doubt))
    if not np.any(doubt[open_now]):
        return made
    unknown, level = 0.0, float(gas[0])
    for k, (share, amount) in enumerate(zip(doubt.tolist(), gas.tolist(), strict=True)):
        # Readings are noisy: only an amount below all before has taken some of it along.
        if open_now[k]:
            if amount < level:
                unknown, level = unknown * amount / level, amount
            if share * amount > unknown:
                unknown, level = share * amount, amount
        made[k] = unknown / amount
    return made
