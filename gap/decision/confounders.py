"""Confounders: other effects, or one number, that could look like effects on the present data."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gap.decision.config import DECISION, DecisionConfig
from gap.decision.presence import only_effects
from gap.estimation.fit_problem import FitProblem
from gap.estimation.information import gather, projected
from gap.model.features import BLOCKS
from gap.model.sensitivities import candidate_columns
from gap.selection.search import SearchResult
from gap.validation.config import VALIDATION
from gap.validation.terms.search import refitted, search_of
from plant.arrays import Array
from plant.effects.catalogue import CATALOGUE


@dataclass(frozen=True)
class Confounder:
    """Other effects that together take `share` of an effect's signature on the present data."""

    ids: tuple[str, ...]
    share: float


class ConfounderSearch:
    """How well candidates stand in for each other on one data set, constants recalibrated."""

    def __init__(self, problem: FitProblem) -> None:
        self.problem = problem
        c = problem.constants(problem.base.shift)
        self._columns = np.nan_to_num(
            candidate_columns(
                problem.model,
                c,
                problem.active_effects(problem.base.shift, (), np.empty(0)),
                problem.candidates,
            )
        )

    def of(
        self, signature: Array, excluded: frozenset[str]
    ) -> tuple[Confounder | None, Confounder | None]:
        """Best single and best pair of other ids for a signature, shape (rows,).

        `excluded` are ids that may not stand in; defects of the recording never do.
        """
        problem = self.problem
        evidence = gather(
            problem.noise,
            problem.columns,
            signature,
            self._columns,
            problem.rows.block,
            problem.rows.compared_s,
            problem.units,
            np.zeros(len(problem.names)),
        )
        p = projected(evidence, evidence.total)
        whole = float(p[0, 0])
        if whole <= 1e-9:
            return None, None
        b = p[0, 1:]
        g = p[1:, 1:]
        norm = np.maximum(np.diag(g), 1e-12)
        signs = np.array([s.sign for s in problem.candidates])
        usable = np.array([s.id not in excluded and not s.defect for s in problem.candidates])
        usable &= np.diag(g) > 1e-9 * whole * 1e-3
        single = np.where(usable & ((signs == 0) | (b > 0.0)), b**2 / norm, 0.0)
        best = int(np.argmax(single))
        one = (
            Confounder((problem.candidates[best].id,), float(single[best] / whole))
            if single[best] > 0
            else None
        )
        return one, self._pair(b, g, norm, signs, usable, whole)

    def _pair(
        self, b: Array, g: Array, norm: Array, signs: Array, usable: npt.NDArray[np.bool_],
        whole: float,
    ) -> Confounder | None:  # fmt: skip
        det = norm[:, None] * norm[None, :] - g**2
        good = usable[:, None] & usable[None, :] & (det > 1e-6 * norm[:, None] * norm[None, :])
        safe = np.where(good, det, 1.0)
        first = (b[:, None] * norm[None, :] - g * b[None, :]) / safe
        second = (b[None, :] * norm[:, None] - g * b[:, None]) / safe
        good &= (signs[:, None] == 0) | (first > 0.0)
        good &= (signs[None, :] == 0) | (second > 0.0)
        ids = np.array([s.id for s in self.problem.candidates])
        good &= ids[:, None] != ids[None, :]
        good &= np.triu(np.ones_like(good))  # a pair in one order, not in that of its last digit
        share = np.where(good, first * b[:, None] + second * b[None, :], 0.0)
        at = np.unravel_index(int(np.argmax(share)), share.shape)
        if share[at] <= 0.0:
            return None
        pair = (str(ids[at[0]]), str(ids[at[1]]))
        return Confounder(pair, float(min(share[at] / whole, 1.0)))


def plainer_channel(
    problem: FitProblem, search: SearchResult, config: DecisionConfig = DECISION
) -> str | None:
    """The channel to which one added number does what the effects of an explanation do.

    Several effects of several kinds seldom begin at once: where one number does as much as all of
    them, something that the catalogue does not hold is the likelier. None if no number does, or if
    one entry of the catalogue alone does much of it: then the others are beside that one. The
    constants are fitted anew with the added number.
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
        if found is None:
            continue
        for piece in found.pieces:
            told = found.terms.explained(piece.at, frozenset()) > _WORTH_FITTING * gained
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


_WORTH_FITTING = 0.5
"""Share of the gain that a number must explain in proportion to be fitted with the constants. A
matter of definition: a large number does more than its proportion says."""
