"""Traits of an explanation: plain numbers from which its reliability is computed."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gap.effects.candidates import Candidate
from gap.estimation.agreement import shared_chi2
from gap.estimation.cross_validation import HeldOut
from gap.estimation.fit_problem import FitProblem
from gap.selection.search import SearchResult
from plant.effects.catalogue import CATALOGUE

_MOST = 1e9
"""Stands for a margin over rivals where none was near enough to be fitted."""


def traits_of(
    problem: FitProblem, search: SearchResult, held: Mapping[str, HeldOut]
) -> dict[str, float]:
    """Traits of what a search found, all plain numbers.

    `excess` and `left` are whitened sums of squares beyond noise before and after, `repeated` and
    `repeated_left` what of them the replicates share, `rows` the number of features; `margin` is
    how much more the best explanation by other effects leaves, `more` what one further effect
    would take of what is left; `bent` and `bent_base` the largest shift of a constant in sd, with
    the effects and without; `closed` the best held-out closed fraction of any channel; `next_seen`
    and `next_gain` how far over the floor, and in whitened squares, the best further effect showed
    that did not count; `first_gain` and `last_gain` what the first and the last effect took away;
    `at_an_end` how many amounts and numbers of shapes stand at an end of their range; `settled`
    whether the data are a table of settled points.
    """
    fit = search.remaining
    others = [c.cost for c in search.rivals if set(c.fit.ids) != set(fit.ids)]
    closed = [c[0] for c in (h.closed() for h in held.values()) if c is not None]
    families = {CATALOGUE[name].family if name in CATALOGUE else name for name in fit.ids}
    refused = search.tests[-1][0] if search.tests and not search.tests[-1][1] else None
    return {
        "rows": float(len(problem.rows)),
        "excess": search.gap,
        "left": search.left,
        "repeated": shared_chi2(problem, problem.base.residual),
        "repeated_left": shared_chi2(problem, fit.residual),
        "effects": float(len(search.best.keys)),
        "same_family": float(len(families) < len(fit.ids)),
        "margin": float(min(min(others, default=np.inf) - search.best.cost, _MOST)),
        "more": max(search.last_gain.values(), default=0.0),
        "bent": float(np.abs(fit.shift).max(initial=0.0)),
        "bent_base": float(np.abs(problem.base.shift).max(initial=0.0)),
        "closed": max(closed, default=0.0),
        "next_seen": refused.visibility if refused else 0.0,
        "next_gain": refused.gain if refused else 0.0,
        "first_gain": search.steps[0][1],
        "last_gain": search.steps[-1][1],
        "at_an_end": float(
            sum(at_an_end(s, a) for s, a in zip(fit.candidates, fit.amounts, strict=True))
        ),
        "settled": float(problem.data.settled),
    }


def at_an_end(candidate: Candidate, amount: float) -> bool:
    """Whether an amount, or a number of its shape, could not go further."""
    low, high = candidate.bounds
    return bool(
        amount >= 0.98 * high or (low < 0.0 and amount <= 0.98 * low) or shape_at_end(candidate)
    )


def shape_at_end(candidate: Candidate) -> bool:
    """Whether a number of a shape could not go further."""
    shapes = [(candidate.shape[key], ends) for key, ends in candidate.free.items()]
    return any(not 1.02 * a < number < 0.98 * b for number, (a, b) in shapes)
