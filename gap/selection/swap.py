"""Explanations by several effects set right: one too many left out, one put in place of another.

The search goes forward: its first effect was chosen while the others were not yet in force, and
may have stood for them.
"""

from __future__ import annotations

import numpy as np

from gap.estimation.fit_problem import Inquiry, State
from gap.estimation.shape_fit import shaped
from gap.selection.inclusion import excess
from gap.selection.refine import Choice, gains_by_key, linear_gains, refine

_ASKED = 2
_CLEARLY = 10.0
"""Weight of an effect, in chance's gain, from which it need not be tried without it."""
_NEAR = 0.5
"""Share of the best gain from which an effect is asked whether it could take another's place."""


def without(q: Inquiry, state: State, key: str) -> State:
    """The state with the effect of `key` taken out and nothing fitted anew."""
    left = [k for k, suspect in enumerate(state.suspects) if suspect.key != key]
    return q.state(state.shift, [state.suspects[k] for k in left], state.amounts[left], state)


def spared(q: Inquiry, choice: Choice, chance: float) -> Choice | None:
    """The choice without an effect that the later ones made needless; None where all are needed.

    Needless is what takes no more than `chance`, in whitened squares.
    """
    for key in choice.keys[:-1]:
        if _weight(choice.state, key) > _CLEARLY * chance:
            continue
        taken = without(q, choice.state, key)
        less = q.polish(q.fit(taken.suspects, taken.amounts.tolist(), choice.state))
        if less.cost - choice.cost < chance:
            return Choice(tuple(k for k in choice.keys if k != key), less)
    return None


def _weight(state: State, key: str) -> float:
    """What taking out the effect of `key` would cost were all linear, in whitened squares."""
    own = np.array([k for k, suspect in enumerate(state.suspects) if suspect.key == key])
    at = own + len(state.shift)
    amounts = state.amounts[own]
    return float(amounts @ np.linalg.lstsq(state.cover[np.ix_(at, at)], amounts)[0])


def exchanged(q: Inquiry, choice: Choice) -> list[Choice]:
    """Choices that have another effect in the place of one of them, best first.

    Constants start from where the whole explanation has them: without one of its effects they
    would bend to what is missing. Such a choice must leave nothing: it could else mend what the
    form of another leaves.
    """
    chance = 2.0 * float(np.sqrt(2.0 * len(q.rows)))
    made = []
    for key in choice.keys:
        taken = without(q, choice.state, key)
        gains, amounts = linear_gains(q, taken)
        best = gains_by_key(q, gains)
        rest = tuple(k for k in choice.keys if k != key)
        top = sorted((k for k in best if k not in choice.keys), key=lambda k: -best[k])[:_ASKED]
        for other in top:
            if best[other] < _NEAR * best[key]:
                continue
            fitted = shaped(q, refine(q, taken, rest, other, gains, amounts).state)
            keys = tuple(other if k == key else k for k in choice.keys)
            state = _in_order(q, fitted, keys)
            if excess(q, state) < chance:
                made.append(Choice(keys, state))
    return sorted(made, key=lambda other: other.cost)


def _in_order(q: Inquiry, state: State, keys: tuple[str, ...]) -> State:
    """The state fitted to the end, its effects in the order of `keys`."""
    order = sorted(range(len(state.suspects)), key=lambda k: keys.index(state.suspects[k].key))
    suspects = [state.suspects[k] for k in order]
    return q.polish(q.state(state.shift, suspects, state.amounts[order], state))
