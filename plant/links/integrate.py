"""Compiled integrators for `motion`."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from plant.arrays import Array
from plant.compiled import called, entry_point, fingerprint
from plant.links.kernel import forward
from plant.links.layout import WORK

METHODS = ("gauss6", "rk4")

_ROOT = math.sqrt(15.0)
# Gauss collocation with three stages: weights of the stages and of the step.
_STAGES = (
    (5 / 36, 2 / 9 - _ROOT / 15, 5 / 36 - _ROOT / 30),
    (5 / 36 + _ROOT / 24, 2 / 9, 5 / 36 - _ROOT / 24),
    (5 / 36 + _ROOT / 30, 2 / 9 + _ROOT / 15, 5 / 36),
)
_STEP = (5 / 18, 4 / 9, 5 / 18)
_MAX_ITERATIONS = 60

_CONTENT = fingerprint("links/kernel.py", "links/integrate.py")


@called
def _rates(
    table: Array, gravity: Array, x: Array, torque: Array, work: Array, d: Array, out: Array
) -> bool:
    """Derivative `out` of the state x = (q, q'). False if D is singular."""
    n = table.shape[0]
    for i in range(n):
        out[i] = x[n + i]
    return forward(table, gravity, x[:n], x[n:], torque, work, d, out[n:])


@called
def _rk4(
    table: Array,
    gravity: Array,
    x: Array,
    torque: Array,
    h: float,
    k: Array,
    trial: Array,
    work: Array,
    d: Array,
) -> bool:
    size = x.shape[0]
    fine = _rates(table, gravity, x, torque, work, d, k[0])
    for stage in range(1, 4):
        part = h if stage == 3 else 0.5 * h
        for i in range(size):
            trial[i] = x[i] + part * k[stage - 1, i]
        fine = fine and _rates(table, gravity, trial, torque, work, d, k[stage])
    for i in range(size):
        x[i] += h / 6.0 * (k[0, i] + 2.0 * k[1, i] + 2.0 * k[2, i] + k[3, i])
    return fine


@called
def _gauss6(
    table: Array,
    gravity: Array,
    x: Array,
    torque: Array,
    h: float,
    k: Array,
    trial: Array,
    work: Array,
    d: Array,
    lost: Array,
) -> bool:
    """One step. The stages are found by fixed-point iteration from those of the previous step.

    `lost` holds the rounding error of each sum (compensated summation), so that rounding errors
    do not accumulate.
    """
    size = x.shape[0]
    last = math.inf
    settled = False
    for _ in range(_MAX_ITERATIONS):
        change = 0.0
        for stage in range(3):
            a, b, c = _STAGES[stage]
            for i in range(size):
                trial[i] = x[i] + h * (a * k[0, i] + b * k[1, i] + c * k[2, i])
            if not _rates(table, gravity, trial, torque, work, d, k[3]):
                return False
            for i in range(size):
                change = max(change, abs(k[3, i] - k[stage, i]) / (1.0 + abs(k[3, i])))
                k[stage, i] = k[3, i]
        # Rounding errors limit the change that can be reached.
        settled = change < 1e-9
        if change < 1e-15 or (settled and change >= last):
            break
        last = change
    for i in range(size):
        step = h * (_STEP[0] * k[0, i] + _STEP[1] * k[1, i] + _STEP[2] * k[2, i]) - lost[i]
        total = x[i] + step
        lost[i] = (total - x[i]) - step
        x[i] = total
    return settled


def _build(content: int) -> Callable[..., int]:
    """Compile the entry point; its closure makes the CRC `content` part of the cache key."""

    @entry_point(
        "int64(float64[:,::1],float64[::1],float64[::1],float64[::1],float64,int64,int64,float64[:,::1])"
    )
    def swing_states(
        table: Array,
        gravity: Array,
        start: Array,
        torque: Array,
        h: float,
        every: int,
        method: int,
        out: Array,
    ) -> int:
        """Fill `out` (samples, 2 n) with states `every` steps apart; returns how many were reached.

        A number below `samples` means that the time step was too long for the motion.
        """
        _ = content
        n = table.shape[0]
        x, trial, lost = start.copy(), np.zeros(2 * n), np.zeros(2 * n)
        k, work, d = np.zeros((4, 2 * n)), np.zeros((n, WORK)), np.zeros((n, n))
        for sample in range(out.shape[0]):
            if sample > 0:
                for _step in range(every):
                    if method == 0:
                        fine = _gauss6(table, gravity, x, torque, h, k, trial, work, d, lost)
                    else:
                        fine = _rk4(table, gravity, x, torque, h, k, trial, work, d)
                    if not fine:
                        return sample
            for i in range(2 * n):
                if not math.isfinite(x[i]):
                    return sample
                out[sample, i] = x[i]
        return int(out.shape[0])

    return swing_states


swing_states = _build(_CONTENT)
