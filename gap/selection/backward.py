"""Backward steps of the search: effects that leave, and effects that change places.

Forward selection chose its first effect while the others were not there; it may have stood for
them.
"""

from __future__ import annotations

import numpy as np

from gap.estimation.fit_problem import FitProblem, FitResult
from gap.estimation.shape_fit import fit_shapes
from gap.selection.candidate_fits import (
    Hypothesis,
    fit_further,
    in_best_form,
    linear_gains,
    with_second_shape,
)
from gap.selection.config import SELECTION, SelectionConfig
from gap.selection.inclusion import excess_chi2, is_included, step_statistics
from plant.effects.catalogue import CATALOGUE


def without(problem: FitProblem, fit: FitResult, key: str) -> FitResult:
    """The fit with the effect of `key` taken out and nothing fitted anew."""
    candidates, amounts = fit.kept(lambda candidate: candidate.key != key)
    return problem.at(fit.shift, candidates, np.array(amounts), fit)


def refitted_without(problem: FitProblem, fit: FitResult, key: str) -> FitResult:
    """The fit with the effect of `key` taken out and all others fitted anew."""
    candidates, amounts = fit.kept(lambda candidate: candidate.key != key)
    return problem.polish(problem.fit(candidates, amounts, fit))


def one_of_family(
    problem: FitProblem,
    hypothesis: Hypothesis,
    gap: float,
    alarm: float,
    config: SelectionConfig = SELECTION,
) -> Hypothesis | None:
    """The last effect without the one before it, of the same family; None where it needs it.

    An effect whose form is not that of the catalogue may first be taken for a relative.
    """
    keys, fit = hypothesis.keys, hypothesis.fit
    if len(keys) < 2 or _family(keys[-1]) != _family(keys[-2]) or keys[-1] == keys[-2]:
        return None
    others, amounts = fit.kept(lambda candidate: candidate.key not in keys[-2:])
    below = problem.fit(others, amounts) if others else problem.base
    linear = linear_gains(problem, below)
    alone = fit_further(problem, Hypothesis(keys[:-2], below), keys[-1], linear, None, config)
    alone = in_best_form(problem, below, alone, linear)
    linear = linear_gains(problem, alone.fit)
    second = with_second_shape(problem, alone, linear, gap, config)
    if second is not None:
        alone = Hypothesis(alone.keys, problem.polish(fit_shapes(problem, second.fit)))
    statistics = step_statistics(problem, gap, alarm, alone.fit, fit, key=keys[-2], config=config)
    return None if is_included(statistics, config) else alone


def _family(key: str) -> str:
    name = key.partition(":")[0]
    return CATALOGUE[name].family if name in CATALOGUE else name


def drop_needless(
    problem: FitProblem, hypothesis: Hypothesis, chance: float, config: SelectionConfig = SELECTION
) -> Hypothesis | None:
    """The explanation without an effect that turned out needless; None without one.

    Needless is what takes no more than `chance`: the later ones took its place, or, of the last
    one, constants and shapes found a better end by way of it, and are better without it as well.
    """
    for key in hypothesis.keys:
        if _linear_weight(hypothesis.fit, key) > config.needless_weight * chance:
            continue
        less = refitted_without(problem, hypothesis.fit, key)
        if less.cost - hypothesis.cost < chance:
            return Hypothesis(tuple(k for k in hypothesis.keys if k != key), less)
    return None


def _linear_weight(fit: FitResult, key: str) -> float:
    """Cost of taking out the effect of `key`, were all linear."""
    own = np.array([k for k, candidate in enumerate(fit.candidates) if candidate.key == key])
    at = own + len(fit.shift)
    amounts = fit.amounts[own]
    return float(amounts @ np.linalg.lstsq(fit.cover[np.ix_(at, at)], amounts)[0])


def swapped(
    problem: FitProblem, hypothesis: Hypothesis, config: SelectionConfig = SELECTION
) -> list[Hypothesis]:
    """Explanations with another effect in the place of one of them, best first.

    Constants start from where the whole explanation has them: without one of its effects they
    would move to what is missing. Such an explanation must leave nothing; else it could correct
    what the form of another leaves.
    """
    chance = 2.0 * float(np.sqrt(2.0 * len(problem.rows)))
    made = []
    for key in hypothesis.keys:
        taken = without(problem, hypothesis.fit, key)
        linear = linear_gains(problem, taken)
        gains = linear.by_key()
        rest = Hypothesis(tuple(k for k in hypothesis.keys if k != key), taken)
        top = sorted((k for k in gains if k not in hypothesis.keys), key=lambda k: -gains[k])
        for other in top[: config.swap_candidates]:
            if gains[other] < config.swap_share * gains[key]:
                continue
            fitted = fit_shapes(
                problem, fit_further(problem, rest, other, linear, None, config).fit
            )
            keys = tuple(other if k == key else k for k in hypothesis.keys)
            fit = _in_order(problem, fitted, keys)
            if excess_chi2(problem, fit) < chance:
                made.append(Hypothesis(keys, fit))
    return sorted(made, key=lambda other: other.cost)


def _in_order(problem: FitProblem, fit: FitResult, keys: tuple[str, ...]) -> FitResult:
    """The fit polished, its effects in the order of `keys`."""
    order = sorted(range(len(fit.candidates)), key=lambda k: keys.index(fit.candidates[k].key))
    candidates = [fit.candidates[k] for k in order]
    return problem.polish(problem.at(fit.shift, candidates, fit.amounts[order], fit))
