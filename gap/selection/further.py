"""Further effects beside an explanation, for which each effect's own probability decides.

The inclusion test of the search asks for a share of the whole gap, so that one large effect hides
others: what takes nine tenths of the rest may take a thousandth of the gap. Here the test is on
what is left alone. It also takes in what only corrects the form of another effect; the probability
of presence (`gap.decision.presence`) is there to refuse that.
"""

from __future__ import annotations

from dataclasses import replace

from gap.estimation.fit_problem import FitProblem
from gap.estimation.shape_fit import fit_shapes
from gap.selection.candidate_fits import (
    Hypothesis,
    LinearGains,
    fit_further,
    is_bent,
    linear_gains,
)
from gap.selection.config import SELECTION, SelectionConfig
from gap.selection.exchange import with_exchanges
from gap.selection.inclusion import StepStatistics, excess_chi2, step_statistics
from gap.selection.search import SearchResult


def with_further(
    problem: FitProblem, search: SearchResult, config: SelectionConfig = SELECTION
) -> SearchResult:
    """A search with further effects in its best explanation, and with exchanges after them.

    Returns:
        The same search where none enters. Defects of the recording never do, nor do effects of a
        family that is there.
    """
    made = _entered(problem, search, config)
    exchanged = with_exchanges(problem, made, config)
    return made if exchanged is made else _entered(problem, exchanged, config)


def _entered(problem: FitProblem, search: SearchResult, config: SelectionConfig) -> SearchResult:
    """A search with further effects, one after the other."""
    made = search
    while len(made.best.keys) < config.most_effects:
        linear = linear_gains(problem, made.best.fit)
        fresh = linear if is_bent(problem, made.best.fit, config) else None
        tried = [
            fit_further(problem, made.best, key, linear, fresh, config)
            for key in _worth_fitting(problem, made.best, linear, made.alarm, config)
        ]
        passed = []
        for one in tried:
            step = step_statistics(
                problem, made.gap, made.alarm, made.best.fit, one.fit, config=config
            )
            if is_further(step, config):
                passed.append(one)
        if not passed:
            break
        first = min(passed, key=lambda one: one.cost)
        fit = problem.polish(fit_shapes(problem, problem.polish(first.fit)))
        steps = (*made.steps, (first.keys[-1], made.best.cost - first.cost))
        made = replace(made, best=Hypothesis(first.keys, fit), steps=steps)
    if made is search:
        return search
    return replace(made, left=excess_chi2(problem, made.best.fit), per_stroke=None)


def is_further(step: StepStatistics, config: SelectionConfig = SELECTION) -> bool:
    """Whether a further effect is no chance, and is visible or takes much of what is left."""
    if step.gain < config.beside_alarms * step.alarm:
        return False
    if step.gain < config.beside_of_gap * step.gap and not step.own_channels:
        return False
    return step.visibility > config.further_visibility or step.of_left > config.beside_of_left


def _worth_fitting(
    problem: FitProblem,
    best: Hypothesis,
    linear: LinearGains,
    alarm: float,
    config: SelectionConfig,
) -> list[str]:
    """Keys of effects of new families with the best linear gains."""
    families = {candidate.family for candidate in best.fit.candidates}
    usable = {c.key for c in problem.candidates if not c.defect and c.family not in families}
    gains = {key: gain for key, gain in linear.by_key().items() if key in usable}
    top = sorted(gains, key=lambda key: -gains[key])[: config.beside_fitted]
    return [key for key in top if gains[key] >= alarm]
