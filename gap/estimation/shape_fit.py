"""Shapes left free: where an effect's knee is, how soon it saturates, how fast it dies away.

The suspects stand a few steps apart in such numbers. Once one of them is chosen its numbers are
fitted as well, together with amounts and constants: an effect that lies between two suspects would
else bend the constants, leave a pattern, and look like something the catalogue does not hold.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from gap.effects.candidates import Suspect
from gap.estimation.fit_problem import Inquiry, State
from gap.estimation.normal_equations import solved

Array = npt.NDArray[np.float64]

_ROUNDS = 8
_STEP = 0.05
"""Change of a number's logarithm at which its signature is taken."""
_STRIDE = 0.8
"""Largest change of a logarithm in one round."""
_LOOSE = 1.0
"""Sd of a number's logarithm about that of the suspect it came from."""


def shaped(q: Inquiry, state: State) -> State:
    """The state with the free numbers of its suspects' shapes fitted too.

    Gauss and Newton over constants, amounts and the logarithms of those numbers, each within its
    range. Returns `state` itself where nothing is free or better.
    """
    free = [(j, key) for j, s in enumerate(state.suspects) for key in s.free]
    if not free:
        return state
    start = _numbers(state.suspects, free)
    constants = q.columns_near(state)
    damping = 1e-4
    for _ in range(_ROUNDS):
        at = _numbers(state.suspects, free)
        slopes = np.hstack(
            [q.slopes(state.shift, state.suspects, state.amounts), _slopes(q, state, free)]
        )
        matrix, right = q.normal(np.hstack([constants, slopes]), state.residual, state.shift)
        last = range(len(matrix) - len(free), len(matrix))
        matrix[last, last] += 1.0 / _LOOSE**2
        right[-len(free) :] -= (at - start) / _LOOSE**2
        better = None
        for _ in range(4):
            beta = solved(matrix, right, damping)
            trial = _moved(q, state, beta, free)
            if trial.cost + _prior(trial, free, start) < state.cost + _prior(state, free, start):
                better = trial
                break
            damping = max(damping, 1e-3) * 10.0
        if better is None:
            break
        damping /= 10.0
        gained = state.cost - better.cost
        state = better
        if gained < max(1.0, 1e-3 * state.cost):
            break
    return state


def _numbers(suspects: Sequence[Suspect], free: list[tuple[int, str]]) -> Array:
    return np.asarray(np.log([suspects[j].shape[key] for j, key in free]))


def _prior(state: State, free: list[tuple[int, str]], start: Array) -> float:
    return float(np.sum((_numbers(state.suspects, free) - start) ** 2)) / _LOOSE**2


def _with(suspects: Sequence[Suspect], free: list[tuple[int, str]], logs: Array) -> list[Suspect]:
    """Suspects with their free numbers set, each within its range."""
    made = list(suspects)
    for (j, key), log in zip(free, logs.tolist(), strict=True):
        low, high = made[j].free[key]
        value = float(np.clip(np.exp(log), low, high))
        made[j] = dataclasses.replace(made[j], shape={**made[j].shape, key: value})
    return made


def _slopes(q: Inquiry, state: State, free: list[tuple[int, str]]) -> Array:
    """Signatures of the free numbers' logarithms, shape (rows, free)."""
    logs = _numbers(state.suspects, free)
    made = np.zeros((len(q.rows), len(free)))
    for i in range(len(free)):
        ends = []
        for way in (-_STEP, _STEP):
            moved = logs.copy()
            moved[i] += way
            suspects = _with(state.suspects, free, moved)
            span = _numbers(suspects, free)[i]
            ends.append((q.residual_at(state.shift, suspects, state.amounts), span))
        span = ends[1][1] - ends[0][1]
        if span > 0.0:
            # Residuals are measured less predicted; signatures are what a prediction gains.
            made[:, i] = (ends[0][0] - ends[1][0]) / span
    return made


def _moved(q: Inquiry, state: State, beta: Array, free: list[tuple[int, str]]) -> State:
    n, amounts = len(state.shift), len(state.amounts)
    logs = _numbers(state.suspects, free)
    logs = logs + np.clip(beta[n + amounts :], -_STRIDE, _STRIDE)
    suspects = _with(state.suspects, free, logs)
    return q.state(state.shift + beta[:n], suspects, state.amounts + beta[n : n + amounts], state)
