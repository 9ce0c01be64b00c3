"""Pruning of what a search found: defects of the recording, and effects that are not needed.

A defect of the recording can take a part of many gaps that it has nothing to do with. It may be the
answer only where it explains the gap alone and every trial has the same amount of it. Otherwise the
search is made again among effects alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import t as student

from gap.estimation.agreement import shared_chi2
from gap.estimation.cross_validation import HeldOut, held_out
from gap.estimation.fit_problem import FitProblem, FitResult
from gap.selection.backward import refitted_without
from gap.selection.candidate_fits import Hypothesis
from gap.selection.config import SELECTION, SelectionConfig
from gap.selection.exchange import with_exchanges
from gap.selection.inclusion import (
    excess_chi2,
    leaves_nothing,
    own_channels,
    relieves_constant,
    step_statistics,
)
from gap.selection.search import SearchResult, search_effects
from plant.effects.catalogue import CATALOGUE


@dataclass(frozen=True)
class PruningResult:
    """The outcome of a search among effects alone.

    Attributes:
        search: the outcome without any defect, unless `defect`.
        defect: whether a defect of the recording is the answer.
        uncertain_defect: whether a defect that is not certain fits far better than any effect.
    """

    search: SearchResult
    defect: bool = False
    uncertain_defect: bool = False


def prune(
    problem: FitProblem, search: SearchResult, config: SelectionConfig = SELECTION
) -> PruningResult:
    """Take defects and effects that are not needed out of what a search found."""
    candidates = search.best.fit.candidates
    if not any(candidate.defect for candidate in candidates):
        return PruningResult(_needed(problem, _exchanged(problem, search, config), config))
    first = candidates[0].defect and not _is_no_fault(problem, search, config)
    sure = first and _is_defect(problem, search, config)
    if sure and not _may_be_slow_sensor(search, config):
        return PruningResult(search, defect=True)
    clean = search_effects(problem.restricted_to(lambda candidate: not candidate.defect), config)
    worse = clean.best.cost - search.best.cost
    uncertain = first and worse > config.sure_gain + config.defect_worse_share * search.gap
    families = {CATALOGUE[name].family for name in clean.best.fit.ids[:1]}
    if sure and (uncertain or families != {"pressure_sensor"}):
        return PruningResult(search, defect=True)
    return PruningResult(
        _needed(problem, _exchanged(problem, clean, config), config), uncertain_defect=uncertain
    )


def _exchanged(problem: FitProblem, search: SearchResult, config: SelectionConfig) -> SearchResult:
    """The outcome without defects, with the exchanges that make it better."""
    return with_exchanges(problem, _without_defects(search), config)


def _without_defects(search: SearchResult) -> SearchResult:
    """The outcome with the rivals that hold no defect."""
    rivals = [h for h in search.rivals if not any(s.defect for s in h.fit.candidates)]
    return replace(search, rivals=rivals)


def _is_defect(problem: FitProblem, search: SearchResult, config: SelectionConfig) -> bool:
    """Whether the first effect, a defect, explains the gap alone and alike in all trials."""
    if search.steps[0][1] < max(config.defect_share * search.gap, config.sure_gain):
        return False
    fit = search.best.fit
    amount = float(fit.amounts[0])
    if fit.candidates[0].id.endswith("clock") and 0.0 < amount < config.least_clock_ms:
        return False
    return _spread_over_trials(problem, fit) < config.defect_spread * abs(amount)


def _is_no_fault(problem: FitProblem, search: SearchResult, config: SelectionConfig) -> bool:
    """Whether the first effect, a defect in time, is hardly wider than one sample, or noise.

    A force that is predicted from a noisy pressure is noisy too: smoothing it takes noise away,
    whatever was recorded; what replicates share is no such noise. And a clock that is off by less
    than a sample is how samples are held.
    """
    candidate, amount = search.best.fit.candidates[0], abs(float(search.best.fit.amounts[0]))
    spacing_s = problem.grid.spacing_s(candidate.search.blocks)
    if candidate.id.endswith("smoothed"):
        noise = config.shared_chance * np.sqrt(2.0 * len(problem.rows))
        narrow = np.sqrt(amount * 1e-3) < config.least_smoothed * spacing_s
        return bool(narrow or shared_chi2(problem, problem.base.residual) < noise)
    return candidate.search.scan == "clock" and amount * 1e-3 < spacing_s


def _may_be_slow_sensor(search: SearchResult, config: SelectionConfig) -> bool:
    """Whether the first effect is a pressure so little late that its sensor may be slow instead.

    The lag of a sensor behind a tube can be of any order; the higher it is, the more it looks like
    a delay.
    """
    fit = search.best.fit
    late_ms = float(fit.amounts[0])
    return fit.candidates[0].id == "pressure_clock" and 0.0 < late_ms < config.slow_sensor_ms


def _spread_over_trials(problem: FitProblem, fit: FitResult) -> float:
    """Spread over trials, beyond chance, of the amount of the first candidate in each trial."""
    slope = problem.slopes(fit.shift, fit.candidates, fit.amounts)[:, 0]
    amounts, weights = [], []
    for trial, rows in enumerate(problem.noise.trial_rows):
        if len(rows):
            both = np.stack([slope[rows], fit.residual[rows]], axis=1)
            gram, _ = problem.noise.solve(trial, both)
            if gram[0, 0] > 0.0:
                amounts.append(gram[0, 1] / gram[0, 0])
                weights.append(gram[0, 0])
    if not weights:
        return float("inf")
    d, w = np.array(amounts), np.array(weights)
    return float(np.sqrt(max(float(w @ d**2) - len(d), 0.0) / w.sum()))


def _needed(problem: FitProblem, search: SearchResult, config: SelectionConfig) -> SearchResult:
    """Take out further effects, last first, that are not needed."""
    while len(search.best.keys) > 1:
        fit, keys = search.best.fit, search.best.keys
        if own_channels(problem, fit, keys[-1]) and search.steps[-1][1] > config.sure_gain:
            break
        less = refitted_without(problem, fit, keys[-1])
        if _is_needed(problem, search, less, config):
            break
        search = replace(
            search,
            best=Hypothesis(keys[:-1], less),
            rivals=[],
            steps=search.steps[:-1],
            left=excess_chi2(problem, less),
        )
    return search


def _is_needed(
    problem: FitProblem, search: SearchResult, less: FitResult, config: SelectionConfig
) -> bool:
    """Whether the last effect is needed beside the fit `less` without it."""
    fit, gain = search.best.fit, search.steps[-1][1]
    s = step_statistics(
        problem, search.gap, search.alarm, less, fit, key=search.best.keys[-1], config=config
    )
    most = max(config.most_gain, config.most_share * s.gap, config.most_of_left * s.left)
    if fit.candidates[-1].single:
        return gain > config.sure_gain  # no other setting can show it
    if gain > most or leaves_nothing(s, config) or relieves_constant(s, config):
        return True  # held-out slots are no test: too few show it, or a constant takes its place
    exact = s.left < 2.0 * s.chance
    part = gain < config.form_share * max(problem.base.cost - fit.cost, 1.0)
    if part and not (s.own_channels or exact) and s.visibility < config.fair_visibility:
        return False  # it corrects the form of the effect before it
    return _gains_surely(held_out(problem, less), held_out(problem, fit), config)


def _gains_surely(
    less: dict[str, HeldOut], more: dict[str, HeldOut], config: SelectionConfig
) -> bool:
    """Whether the held-out error of some block falls for certain, over units, with more effects."""
    for block, held in more.items():
        use = held.weight > 0.0
        gain = (less[block].after - held.after)[use]
        if len(gain) < 3:
            return True
        error = float(gain.std(ddof=1) / np.sqrt(len(gain)))
        if float(gain.mean()) > float(student.ppf(config.held_out_level, len(gain) - 1)) * error:
            return True
    return False
