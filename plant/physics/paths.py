"""Operators with memory along recorded paths, all trials in one compiled call.

Importing this module loads numba.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from plant.compiled import entry_point, fingerprint, inlined
from plant.physics.friction import element_slip
from plant.physics.layout import SLIP_ELEMENTS

_element = inlined(element_slip)


def _build(sources: int) -> tuple[Callable[..., None], ...]:
    vector = "float64[::1]"

    @entry_point(f"void(int64[::1], {vector}, {vector})")
    def slip(first: Any, travel: Any, out: Any) -> None:
        """Mean slip of the friction elements along `travel`, fresh at the start of each trial."""
        if sources < 0:
            return
        z = np.zeros(SLIP_ELEMENTS)
        for t in range(len(first) - 1):
            z[:] = 0.0
            for i in range(first[t], first[t + 1]):
                step = 0.0 if i == first[t] else travel[i] - travel[i - 1]
                total = 0.0
                for e in range(SLIP_ELEMENTS):
                    z[e] = _element(z[e], step, e)
                    total += z[e]
                out[i] = total / SLIP_ELEMENTS

    @entry_point(f"void(int64[::1], {vector}, {vector}, float64, {vector})")
    def lag(first: Any, time: Any, x: Any, tau: float, out: Any) -> None:
        """First-order lag of x with time constant `tau`, at rest at the start of each trial."""
        if sources < 0:
            return
        for t in range(len(first) - 1):
            y = 0.0
            for i in range(first[t], first[t + 1]):
                if i == first[t]:
                    y = x[i]
                else:
                    share = np.exp(-(time[i] - time[i - 1]) / tau)
                    y = x[i] + (y - x[i]) * share
                out[i] = y

    @entry_point(f"void(int64[::1], {vector}, {vector}, {vector})")
    def play(first: Any, x: Any, half: Any, out: Any) -> None:
        """Follow x with a play of `half` (one a trial) either way: its noise turns nothing."""
        if sources < 0:
            return
        for t in range(len(first) - 1):
            y = 0.0
            for i in range(first[t], first[t + 1]):
                if i == first[t]:
                    y = x[i]
                elif x[i] > y + half[t]:
                    y = x[i] - half[t]
                elif x[i] < y - half[t]:
                    y = x[i] + half[t]
                out[i] = y

    return slip, lag, play


slip, lag, play = _build(fingerprint())
