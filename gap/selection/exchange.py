"""Exchanges of one or two effects of an explanation for others.

Forward selection takes the effects one after the other. Where two act in the same channels, a third
may have stood for both of them when it entered, and a swap of one effect does not lead out of that.
So all exchanges of at most two effects of an explanation for at most two others are compared, from
inner products of sensitivities (all linearised at the fit), and the best are fitted.

An explanation is judged by what it leaves and by the number of its effects, each of which costs
`SelectionConfig.exchange_cost` alarms.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import numpy.typing as npt

from gap.effects.candidates import Candidate
from gap.estimation.fit_problem import FitProblem
from gap.estimation.shape_fit import fit_shapes
from gap.selection.candidate_fits import Hypothesis
from gap.selection.config import SELECTION, SelectionConfig
from gap.selection.inclusion import excess_chi2
from gap.selection.search import SearchResult
from plant.arrays import Array

Flags = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Exchange:
    """Keys that leave an explanation, candidates that enter with their amounts, and the cost then.

    The cost is chi-square with that of the effects, linearised at the explanation.
    """

    out: tuple[str, ...]
    entering: tuple[Candidate, ...]
    amounts: tuple[float, ...]
    cost: float

    @property
    def keys(self) -> tuple[str, ...]:
        """Keys that enter."""
        return tuple(candidate.key for candidate in self.entering)


def with_exchanges(
    problem: FitProblem, search: SearchResult, config: SelectionConfig = SELECTION
) -> SearchResult:
    """A search whose best explanation no exchange of effects makes better.

    Returns:
        The same search where it has one effect or none, or where nothing is better.
    """
    best = search.best
    if len(best.keys) < 2:
        return search
    each = config.exchange_cost * search.alarm
    for rival in search.rivals:
        # A rival that was fitted to the end after the search had passed it by.
        if len(rival.keys) <= config.most_effects and _is_better(
            problem, rival, best, each, config
        ):
            best = rival
    seen = {frozenset(best.keys)}
    for _ in range(config.exchange_rounds):
        found = None
        for exchange in proposals(problem, best, each, config):
            keys = (*(k for k in best.keys if k not in exchange.out), *exchange.keys)
            if frozenset(keys) in seen or len(keys) > config.most_effects:
                continue
            seen.add(frozenset(keys))
            made = _fitted(problem, best, exchange, keys)
            if _is_better(problem, made, best, each, config):
                found = made
                break
        if found is None:
            break
        best = found
    if best is search.best:
        return search
    left = excess_chi2(problem, best.fit)
    kept = tuple(step for step in search.steps if step[0] in best.keys)
    # What a new effect took when it entered is not known: its part of all that is explained.
    part = max(search.gap - left, 0.0) / len(best.keys)
    new = tuple((k, part) for k in best.keys if k not in dict(kept))
    others = (one for one in (search.best, *search.rivals) if one is not best)
    rivals = sorted(others, key=lambda one: one.cost)
    return replace(
        search, best=best, rivals=rivals, left=left, steps=(*kept, *new), per_stroke=None
    )


def _is_better(
    problem: FitProblem, made: Hypothesis, best: Hypothesis, each: float, config: SelectionConfig
) -> bool:
    """Whether an explanation leaves less, by more than its effects cost and a chance could."""
    more = max(len(made.keys) - len(best.keys), 0)
    least = each + more * config.beside_of_left * excess_chi2(problem, best.fit)
    return made.cost + each * len(made.keys) < best.cost + each * len(best.keys) - least


def proposals(
    problem: FitProblem, best: Hypothesis, each: float, config: SelectionConfig = SELECTION
) -> list[Exchange]:
    """Exchanges that look better than the explanation, best first; one for each set of keys.

    Args:
        each: what an effect costs, in chi-square.
    """
    made: dict[tuple[tuple[str, ...], frozenset[str]], Exchange] = {}
    now = best.cost + each * len(best.keys)
    for exchange in _exchanges(problem, best, each):
        place = (exchange.out, frozenset(exchange.keys))
        if exchange.cost < now and (place not in made or exchange.cost < made[place].cost):
            made[place] = exchange
    return sorted(made.values(), key=lambda one: one.cost)[: config.exchange_fitted]


_KEPT = 40
"""Pairs of candidates that are kept for each set of effects that leaves."""
_RIDGE = 1e-10
"""Added to the scaled diagonal: columns of constants that the data do not move are all zero."""
_ALIKE = 1e-3
"""Share of a candidate's square beyond another, below which the two cannot be told apart."""


@dataclass(frozen=True)
class _Opening:
    """What candidates may take once some effects are out and all others have given way.

    Attributes:
        out: keys that leave.
        kept: number of keys that stay.
        candidates: that may enter: of families that are not there.
        products: inner products of what is theirs alone, shape (candidates, candidates).
        taken: the same with what is to be explained, shape (candidates,).
        cost: chi-square before any of them enters.
    """

    out: tuple[str, ...]
    kept: int
    candidates: tuple[Candidate, ...]
    products: Array
    taken: Array
    cost: float

    @property
    def norm(self) -> Array:
        """Square of what each candidate has alone."""
        return np.maximum(np.diag(self.products), 1e-9)

    @property
    def positive(self) -> Flags:
        """Candidates whose amounts may not be negative."""
        return np.array([candidate.sign > 0 for candidate in self.candidates], dtype=np.bool_)

    def with_one(self, each: float) -> Iterator[Exchange]:
        """Exchanges for one candidate."""
        amounts = self.taken / self.norm
        cost = self.cost - self.taken * amounts + each * (self.kept + 1)
        for j in np.flatnonzero(~(self.positive & (amounts < 0.0))).tolist():
            yield Exchange(self.out, (self.candidates[j],), (float(amounts[j]),), float(cost[j]))

    def with_two(self, each: float) -> Iterator[Exchange]:
        """The best exchanges for two candidates of different families."""
        norm, across, taken = self.norm, self.products, self.taken
        squares = norm[:, None] * norm
        det = squares - across**2
        wrong = det < _ALIKE * squares
        det = np.where(wrong, 1.0, det)
        first = (taken[:, None] * norm - across * taken) / det
        second = (taken * norm[:, None] - across * taken[:, None]) / det
        family = np.array([candidate.family for candidate in self.candidates])
        wrong |= family[:, None] == family
        wrong |= self.positive[:, None] & (first < 0.0)
        wrong |= self.positive & (second < 0.0)
        wrong |= np.tri(len(norm), dtype=bool)
        gain = np.where(wrong, -np.inf, first * taken[:, None] + second * taken)
        below = self.cost + each * (self.kept + 2)
        for flat in np.argsort(-gain, axis=None)[:_KEPT].tolist():
            i, j = divmod(flat, len(norm))
            if not np.isfinite(gain[i, j]):
                break
            yield Exchange(
                self.out, (self.candidates[i], self.candidates[j]),
                (float(first[i, j]), float(second[i, j])), float(below - gain[i, j]),
            )  # fmt: skip


def _exchanges(problem: FitProblem, best: Hypothesis, each: float) -> Iterator[Exchange]:
    """Exchanges of one or two effects for one or two others, linearised at the explanation."""
    for opening in _openings(problem, best):
        yield from opening.with_one(each)
        yield from opening.with_two(each)


def _openings(problem: FitProblem, best: Hypothesis) -> Iterator[_Opening]:
    """What is left to explain without any one or two of the effects."""
    fit, n = best.fit, len(problem.names)
    here = n + np.arange(len(fit.candidates))
    beyond = n + len(here)
    # Inner products of [constants | effects in force | candidates], and those with the residual.
    gram, right = problem.normal(problem.all_columns(fit), fit.residual, fit.shift)
    for out in (*combinations(best.keys, 1), *combinations(best.keys, 2)):
        leaves = np.array([candidate.key in out for candidate in fit.candidates])
        own, amounts = here[leaves], fit.amounts[leaves]
        stay = np.r_[np.arange(n), here[~leaves]]
        there = {c.family for c, gone in zip(fit.candidates, leaves, strict=True) if not gone}
        may = [
            j
            for j, c in enumerate(problem.candidates)
            if not c.defect and c.key not in out and c.family not in there
        ]
        enter = beyond + np.array(may, dtype=np.int64)
        # What the effects that leave have added is to be explained anew.
        y = right + gram[:, own] @ amounts
        added = float(2.0 * amounts @ right[own] + amounts @ gram[np.ix_(own, own)] @ amounts)
        unit = np.sqrt(np.maximum(np.diag(gram)[stay], 1e-300))
        inner = gram[np.ix_(stay, stay)] / unit / unit[:, None] + _RIDGE * np.eye(len(stay))
        across = gram[np.ix_(stay, enter)] / unit[:, None]
        given = np.linalg.solve(inner, np.column_stack([across, y[stay] / unit]))
        yield _Opening(
            out,
            len(best.keys) - len(out),
            tuple(problem.candidates[j] for j in may),
            gram[np.ix_(enter, enter)] - across.T @ given[:, :-1],
            y[enter] - across.T @ given[:, -1],
            fit.cost + added - float(y[stay] / unit @ given[:, -1]),
        )


def _fitted(
    problem: FitProblem, best: Hypothesis, exchange: Exchange, keys: tuple[str, ...]
) -> Hypothesis:
    """An exchange fitted, from where the explanation has the constants and from those stated."""
    candidates, amounts = best.fit.kept(lambda candidate: candidate.key not in exchange.out)
    candidates = [*candidates, *exchange.entering]
    start = [*amounts, *exchange.amounts]
    ends = [
        problem.fit_from(best.fit.shift, candidates, start),
        problem.fit_afresh(candidates, start),
    ]
    first = min(ends, key=lambda end: end.cost)
    return Hypothesis(keys, problem.polish(fit_shapes(problem, problem.polish(first))))
