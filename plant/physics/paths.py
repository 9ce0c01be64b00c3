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
from plant.physics.turns import LEAST, monotone_levels, next_turn, pool, resting

_element = inlined(element_slip)
_turn, _levels = inlined(next_turn), inlined(monotone_levels)
_resting, _pool = inlined(resting), inlined(pool)


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
    def between_turns(first: Any, x: Any, noise: Any, out: Any) -> None:
        """The path x made monotone between its turns; `noise` is its sd, one a trial."""
        if sources < 0:
            return
        n = len(x)
        begins, total, count = np.empty(n, dtype=np.int64), np.empty(n), np.empty(n)
        for t in range(len(first) - 1):
            begin, end = first[t], first[t + 1]
            while begin < end:
                turn, way = _turn(x, begin, end, LEAST * noise[t])
                levels = _levels(x, begin, turn, way, begins, total, count)
                if begin > first[t]:
                    _pool(total, count, 0, _resting(total, count, 0, levels, 1, noise[t]))
                if turn < end:
                    rest = _resting(total, count, levels - 1, -1, -1, noise[t])
                    _pool(total, count, levels - rest, levels)
                for at in range(levels):
                    for i in range(begins[at], begins[at] + int(count[at])):
                        out[i] = way * total[at] / count[at]
                begin = turn

    return slip, lag, between_turns


slip, lag, between_turns = _build(fingerprint())
