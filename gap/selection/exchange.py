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

from gap.effects.candidates import Candidate
from gap.estimation.fit_problem import FitProblem, FitResult
from gap.estimation.information import tolerance
from gap.estimation.shape_fit import fit_shapes
from gap.selection.candidate_fits import Hypothesis
from gap.selection.config import SELECTION, SelectionConfig
from gap.selection.inclusion import excess_chi2
from gap.selection.search import SearchResult
from plant.arrays import Array


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
    """A search whose best explanation no exchange of effects makes better."""
    best = search.best
    each = config.exchange_cost * search.alarm
    seen = {frozenset(best.keys)}
    for _ in range(config.exchange_rounds):
        found = None
        for exchange in proposals(problem, best, each, config):
            keys = (*(k for k in best.keys if k not in exchange.out), *exchange.keys)
            if frozenset(keys) in seen or len(keys) > config.most_effects:
                continue
            seen.add(frozenset(keys))
            made = _fitted(problem, best, exchange, keys)
            more = max(len(made.keys) - len(best.keys), 0)
            least = each + more * config.beside_of_left * excess_chi2(problem, best.fit)
            if made.cost + each * len(made.keys) < best.cost + each * len(best.keys) - least:
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
    rivals = sorted((search.best, *search.rivals), key=lambda one: one.cost)
    return replace(
        search, best=best, rivals=rivals, left=left, steps=(*kept, *new), per_stroke=None
    )


def cost_without(problem: FitProblem, best: Hypothesis, each: float) -> dict[str, float]:
    """By effect, how much the best exchange that takes it out costs more than the explanation.

    All linearised at the explanation; below zero where the exchange costs less.

    Args:
        each: what an effect costs, in chi-square.
    """
    now = best.cost + each * len(best.keys)
    made: dict[str, float] = {}
    for exchange in _exchanges(problem, best, each):
        for name in {key.partition(":")[0] for key in exchange.out}:
            if not any(k.partition(":")[0] == name for k in best.keys if k not in exchange.out):
                made[name] = min(made.get(name, np.inf), exchange.cost - now)
    return made


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


def _exchanges(problem: FitProblem, best: Hypothesis, each: float) -> Iterator[Exchange]:
    fit = best.fit
    candidates = [c for c in problem.candidates if not c.defect]
    gram, right, n = _products(problem, fit, candidates)
    k = len(fit.candidates)
    family = np.array([c.family for c in candidates])
    positive = np.array([c.sign > 0 for c in candidates])
    for out in (*combinations(best.keys, 1), *combinations(best.keys, 2)):
        own = [j for j, c in enumerate(fit.candidates) if c.key in out]
        stay = np.r_[np.arange(n), [n + j for j in range(k) if j not in own]].astype(np.int64)
        rest = n + k + np.arange(len(candidates))
        # What the effects that leave have added is to be explained anew.
        y = right.copy()
        for j in own:
            y = y + gram[:, n + j] * fit.amounts[j]
        inner = gram[np.ix_(stay, stay)]
        scale = np.sqrt(np.maximum(np.diag(inner), 1e-300))
        inner = inner / scale / scale[:, None] + 1e-10 * np.eye(len(stay))
        across = gram[np.ix_(stay, rest)] / scale[:, None]
        both = np.linalg.solve(inner, np.column_stack([across, y[stay] / scale]))
        s = gram[np.ix_(rest, rest)] - across.T @ both[:, :-1]
        r = y[rest] - across.T @ both[:, -1]
        lost = sum(
            2.0 * fit.amounts[j] * right[n + j]
            + sum(fit.amounts[j] * gram[n + j, n + i] * fit.amounts[i] for i in own)
            for j in own
        )
        gained = float(y[stay] / scale @ both[:, -1])
        below = fit.cost + float(lost) - gained
        there = {c.family for c in fit.candidates if c.key not in out}
        usable = np.array([f not in there for f in family])
        usable &= np.array([c.key not in out for c in candidates])
        norm = np.maximum(np.diag(s), 1e-9)
        fixed = len(best.keys) - len(out)
        for j in np.flatnonzero(usable):
            amount = r[j] / norm[j]
            if not (positive[j] and amount < 0.0):
                cost = below - r[j] ** 2 / norm[j] + each * (fixed + 1)
                yield Exchange(out, (candidates[j],), (float(amount),), float(cost))
        yield from _pairs(
            out, candidates, s, r, np.where(usable)[0], positive, family,
            below + each * (fixed + 2),
        )  # fmt: skip


def _pairs(
    out: tuple[str, ...], candidates: list[Candidate], s: Array, r: Array, at: Array,
    positive: Array, family: Array, below: float,
) -> Iterator[Exchange]:  # fmt: skip
    """The best pairs that may enter in the place of `out`."""
    a = s[np.ix_(at, at)]
    norm = np.maximum(np.diag(a), 1e-9)
    det = norm[:, None] * norm - a**2
    alike = det < 1e-3 * norm[:, None] * norm
    det = np.where(alike, 1.0, det)
    q = r[at]
    first = (q[:, None] * norm - a * q) / det
    second = (q * norm[:, None] - a * q[:, None]) / det
    gain = first * q[:, None] + second * q
    wrong = alike | (family[at][:, None] == family[at])
    wrong |= positive[at][:, None] & (first < 0.0)
    wrong |= positive[at] & (second < 0.0)
    gain = np.where(wrong | np.tri(len(at), dtype=bool), -np.inf, gain)
    for flat in np.argsort(-gain, axis=None)[:_KEPT].tolist():
        i, j = divmod(flat, len(at))
        if not np.isfinite(gain[i, j]):
            break
        yield Exchange(
            out, (candidates[at[i]], candidates[at[j]]), (float(first[i, j]), float(second[i, j])),
            float(below - gain[i, j]),
        )  # fmt: skip


def _products(
    problem: FitProblem, fit: FitResult, candidates: list[Candidate]
) -> tuple[Array, Array, int]:
    """Inner products of [constants | effects in force | candidates], and with the residual.

    The prior of the constants is included. Also the number of constants.
    """
    made = problem.exchange_columns(fit)
    n = len(problem.names)
    place = {id(c): j for j, c in enumerate(problem.candidates)}
    k = len(fit.candidates)
    at = np.r_[np.arange(n + k), [n + k + place[id(c)] for c in candidates]].astype(np.int64)
    both = np.column_stack([made[:, at], fit.residual])
    gram = np.zeros((len(at) + 1,) * 2)
    for trial, rows in enumerate(problem.noise.trial_rows):
        if len(rows):
            gram += problem.noise.solve(trial, both[rows])[0]
    _, slope, stiffness = tolerance(fit.shift)
    right = gram[:-1, -1].copy()
    gram = gram[:-1, :-1].copy()
    gram[range(n), range(n)] += stiffness
    right[:n] -= slope
    return gram, right, n


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
