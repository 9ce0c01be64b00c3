"""Explanations by several effects set right: one too many left out, one put in place of another.

The search goes forward: its first effect was chosen while the others were not yet in force, and
may have stood for them.
"""

from __future__ import annotations

import numpy as np

from gap.estimation.fit_problem import FitProblem, FitResult
from gap.estimation.shape_fit import fit_shapes
from gap.selection.inclusion import excess_chi2
from gap.selection.refine import Hypothesis, gains_by_key, linear_gains, refine

_ASKED = 2
_CLEARLY = 10.0
"""Weight of an effect, in chance's gain, from which it need not be tried without it."""
_NEAR = 0.5
"""Share of the best gain from which an effect is asked whether it could take another's place."""


def without(problem: FitProblem, fit: FitResult, key: str) -> FitResult:
    """The fit with the effect of `key` taken out and nothing fitted anew."""
    left = [k for k, candidate in enumerate(fit.candidates) if candidate.key != key]
    return problem.at(fit.shift, [fit.candidates[k] for k in left], fit.amounts[left], fit)


def drop_needless(problem: FitProblem, hypothesis: Hypothesis, chance: float) -> Hypothesis | None:
    """The choice without an effect that the later ones made needless; None where all are needed.

    Needless is what takes no more than `chance`, in whitened squares.
    """
    for key in hypothesis.keys[:-1]:
        if _weight(hypothesis.fit, key) > _CLEARLY * chance:
            continue
        taken = without(problem, hypothesis.fit, key)
        less = problem.polish(problem.fit(taken.candidates, taken.amounts.tolist(), hypothesis.fit))
        if less.cost - hypothesis.cost < chance:
            return Hypothesis(tuple(k for k in hypothesis.keys if k != key), less)
    return None


def _weight(fit: FitResult, key: str) -> float:
    """What taking out the effect of `key` would cost were all linear, in whitened squares."""
    own = np.array([k for k, candidate in enumerate(fit.candidates) if candidate.key == key])
    at = own + len(fit.shift)
    amounts = fit.amounts[own]
    return float(amounts @ np.linalg.lstsq(fit.cover[np.ix_(at, at)], amounts)[0])


def swapped(problem: FitProblem, hypothesis: Hypothesis) -> list[Hypothesis]:
    """Choices that have another effect in the place of one of them, best first.

    Constants start from where the whole explanation has them: without one of its effects they
    would bend to what is missing. Such a choice must leave nothing: it could else mend what the
    form of another leaves.
    """
    chance = 2.0 * float(np.sqrt(2.0 * len(problem.rows)))
    made = []
    for key in hypothesis.keys:
        taken = without(problem, hypothesis.fit, key)
        gains, amounts = linear_gains(problem, taken)
        best = gains_by_key(problem, gains)
        rest = tuple(k for k in hypothesis.keys if k != key)
        top = sorted((k for k in best if k not in hypothesis.keys), key=lambda k: -best[k])[:_ASKED]
        for other in top:
            if best[other] < _NEAR * best[key]:
                continue
            fitted = fit_shapes(problem, refine(problem, taken, rest, other, gains, amounts).fit)
            keys = tuple(other if k == key else k for k in hypothesis.keys)
            fit = _in_order(problem, fitted, keys)
            if excess_chi2(problem, fit) < chance:
                made.append(Hypothesis(keys, fit))
    return sorted(made, key=lambda other: other.cost)


def _in_order(problem: FitProblem, fit: FitResult, keys: tuple[str, ...]) -> FitResult:
    """The fit fitted to the end, its effects in the order of `keys`."""
    order = sorted(range(len(fit.candidates)), key=lambda k: keys.index(fit.candidates[k].key))
    candidates = [fit.candidates[k] for k in order]
    return problem.polish(problem.at(fit.shift, candidates, fit.amounts[order], fit))
