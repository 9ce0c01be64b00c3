"""Whether one number, added to one channel, does what several effects together do.

Several effects of several kinds seldom begin at once. Where one number does as much as all of
them, something that the catalogue does not hold is the likelier.
"""

from __future__ import annotations

import numpy as np

from gap.decision.config import DECISION, DecisionConfig
from gap.decision.presence import only_effects
from gap.estimation.fit_problem import FitProblem
from gap.model.features import BLOCKS
from gap.selection.search import SearchResult
from gap.validation.config import VALIDATION
from gap.validation.terms.search import refitted, search_of
from plant.effects.catalogue import CATALOGUE


def plainer_channel(
    problem: FitProblem, search: SearchResult, config: DecisionConfig = DECISION
) -> str | None:
    """The channel to which one added number does what the effects of an explanation do.

    None if there is none, or if one entry of the catalogue alone does much of it: then the others
    are beside that one. The constants are fitted anew with the added number.
    """
    fit = search.best.fit
    if len({CATALOGUE[name].family for name in fit.ids}) < 2:
        return None
    gained = problem.base.cost - fit.cost
    if max(search.first_gain.values(), default=0.0) > config.plainer_single * gained:
        return None
    best, most = None, config.plainer_share * gained
    for number in np.unique(problem.rows.block).tolist():
        found = search_of(problem, problem.base, BLOCKS[number], VALIDATION)
        for piece in found.pieces if found is not None else ():
            assert found is not None
            told = found.terms.explained(piece.at, frozenset()) > _HALF * gained
            if len(piece.at) > 1 or not told:
                continue
            gain = problem.base.cost - refitted(problem, found, [piece])[1].cost
            if gain > most:
                best, most = BLOCKS[number], gain
    if best is None:
        return None
    alone = (only_effects(problem, search, (name,)).best.fit.cost for name in fit.ids)
    does_much = any(problem.base.cost - cost > config.plainer_single * gained for cost in alone)
    return None if does_much else best


_HALF = 0.5
"""Share of the gain below which a number that is fitted in proportion is not fitted in full."""
