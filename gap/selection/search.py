"""The search for the effects that explain a gap: forward selection with backward steps.

Each round has a forward step (the best candidate enters, if it passes its test) and backward steps
(an effect that became needless leaves, and a better one takes the place of another). An effect may
use two of its shapes at once, so that one effect of another form does not count as two. Every
explanation that is nearly as good is kept as a rival.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from daq.progress import counted, stage
from gap.effects.candidates import Candidate
from gap.estimation.agreement import replicate_inflation
from gap.estimation.fit_problem import FitProblem, FitResult
from gap.estimation.non_identical import non_identical
from gap.estimation.null_distribution import held_out_gain, simulated_null
from gap.estimation.shape_fit import fit_shapes
from gap.selection.backward import drop_needless, one_of_family, swapped
from gap.selection.candidate_fits import (
    Hypothesis,
    LinearGains,
    curved_instead,
    fit_further,
    is_bent,
    keys_of_shifted_constants,
    linear_gains,
    near_cost,
    rivals_in_best_form,
    with_second_shape,
)
from gap.selection.config import SELECTION, SelectionConfig
from gap.selection.inclusion import (
    StepStatistics,
    excess_chi2,
    is_included,
    own_channels,
    same_family,
    step_statistics,
    visibility,
)
from gap.verdict import Rejection, WhyNot
from plant.arrays import Array

Steps = tuple[tuple[str, float], ...]


@dataclass(frozen=True)
class SearchResult:
    """What the search found.

    Attributes:
        best: the best explanation; it has no keys where nothing reached the alarm.
        rivals: other explanations with as many effects, best first.
        first_gain: gain of the best single effect, by key, linearised at the base.
        gap: chi-square of the recalibrated plant beyond the number of rows.
        left: the same of the best explanation.
        alarm: gain that a first effect needs on these data.
        chance: share of simulated data sets without a gap whose best gain is as large.
        steps: key and gain of each effect in the order of entry; one that came by an exchange has
            an equal part of all that is explained.
        tests: inclusion tests beyond the first step, with their outcomes.
        last_gain: gain of each key beside the best explanation, linearised.
        per_stroke: the best explanation with a delay of its own for each stroke, if it has delays.
    """

    best: Hypothesis
    rivals: list[Hypothesis]
    first_gain: dict[str, float]
    gap: float
    left: float
    alarm: float = SELECTION.least_gain
    chance: float = 1.0
    steps: Steps = ()
    tests: tuple[tuple[StepStatistics, bool], ...] = ()
    last_gain: dict[str, float] = field(default_factory=dict)
    per_stroke: FitResult | None = None

    @property
    def remaining(self) -> FitResult:
        """The fit whose residual speaks for or against the explanation."""
        return self.per_stroke or self.best.fit


def search_effects(problem: FitProblem, config: SelectionConfig = SELECTION) -> SearchResult:
    """Search for the effects that explain the gap of a problem."""
    stage(f"sensitivities of {len(problem.candidates)} candidates")
    linear, fresh = _first_gains(problem, config)
    null = simulated_null(problem)
    gap = excess_chi2(problem, problem.base)
    search = SearchResult(
        best=Hypothesis((), problem.base),
        rivals=[],
        first_gain=linear.by_key(),
        gap=gap,
        left=gap,
        alarm=max(config.least_gain, config.null_factor * null.threshold(config.null_rate)),
        chance=null.chance(float(linear.gain.max(initial=0.0))),
    )
    for _ in range(config.most_effects):
        previous = search
        search, linear = _forward_step(problem, search, linear, fresh, config)
        if search.best is previous.best:
            break
        fresh = None
        entered = search.best
        search = _backward_steps(problem, previous, search, config)
        if search.best is not entered:
            linear = linear_gains(problem, search.best.fit)
    return replace(
        search,
        rivals=_polished(problem, search, config),
        left=excess_chi2(problem, search.best.fit),
        last_gain=linear.by_key(),
    )


def _first_gains(
    problem: FitProblem, config: SelectionConfig
) -> tuple[LinearGains, LinearGains | None]:
    """Gains at the base, and those at the stated plant where a constant has moved far.

    A large effect may have moved the constants; its gain is then taken at the stated plant, scaled
    to the gains at the base. Clock offsets and delays that are too large for a sensitivity to show
    are tried as they are.
    """
    base = problem.base
    linear, fresh = linear_gains(problem, base), None
    if np.abs(base.shift).max(initial=0.0) > config.shifted_constant_sd:
        fresh = linear_gains(problem, problem.stated())
        scale = linear.gain.max(initial=0.0) / max(fresh.gain.max(initial=0.0), 1e-9)
        most = np.minimum(fresh.gain * max(float(scale), 0.0), excess_chi2(problem, base))
        linear = replace(linear, gain=np.maximum(linear.gain, most))
    if excess_chi2(problem, base) < config.scan_excess_per_row * len(problem.rows):
        return linear, fresh
    scanned = _scan_clocks(problem, config)
    if non_identical(problem.data):
        scanned |= _scan_delays(problem, config)
    gain, amount = linear.gain.copy(), linear.amount.copy()
    afresh = None if fresh is None else fresh.amount.copy()
    for j, candidate in enumerate(problem.candidates):
        found = scanned.get(candidate.key, (0.0, 0.0))
        if found[0] > gain[j]:
            gain[j], amount[j] = found
            if afresh is not None:
                afresh[j] = found[1]
    if fresh is not None and afresh is not None:
        fresh = replace(fresh, amount=afresh)
    return LinearGains(problem.candidates, gain, amount), fresh


def _forward_step(
    problem: FitProblem,
    search: SearchResult,
    linear: LinearGains,
    fresh: LinearGains | None,
    config: SelectionConfig,
) -> tuple[SearchResult, LinearGains]:
    """Let the best candidate enter that passes its test; the search as it was where none does."""
    before = search.best
    gains = {key: gain for key, gain in linear.by_key().items() if key not in before.keys}
    top = sorted(gains, key=lambda key: -gains[key])
    shifted = [k for k in keys_of_shifted_constants(problem, before.fit) if k not in before.keys]
    if not top or not (shifted or _is_alarm(problem, search, top[0], gains[top[0]], config)):
        return search, linear
    bent = bool(before.keys) and is_bent(problem, before.fit, config)
    keys = dict.fromkeys([*_worth_fitting(problem, before, top, gains, bent, config), *shifted])
    if bent:
        fresh = linear
    fitting = counted(f"effect {len(before.keys) + 1}: fit", keys)
    tried = [fit_further(problem, before, key, linear, fresh, config) for key in fitting]
    stage(f"effect {len(before.keys) + 1}: best forms")
    tried = rivals_in_best_form(problem, before.fit, tried, linear, config)
    if before.keys:
        passed, search = _passed(problem, search, tried, config)
    else:
        passed = [h for h in tried if _stands_out(problem, search, h, config)]
    if not passed:
        return search, linear
    first = passed[0]
    instead = curved_instead(problem, before, first)
    if instead is not before:
        return replace(search, best=instead), linear_gains(problem, instead.fit)
    rivals = [h for h in (passed if before.keys else tried) if h is not first]
    best = Hypothesis(first.keys, problem.polish(fit_shapes(problem, problem.polish(first.fit))))
    linear = linear_gains(problem, best.fit)
    second = with_second_shape(problem, best, linear, search.gap, config)
    if second is not None:
        best = Hypothesis(best.keys, fit_shapes(problem, second.fit))
        linear = linear_gains(problem, best.fit)
    steps = (*search.steps, (best.keys[-1], before.cost - first.cost))
    return replace(search, best=best, rivals=rivals, steps=steps), linear


def _is_alarm(
    problem: FitProblem, search: SearchResult, key: str, gain: float, config: SelectionConfig
) -> bool:
    """Whether the best linear gain is no chance.

    The first one must also be larger than the disagreement of replicates explains, and a small
    first one must have a gain on held-out slots.
    """
    if gain < search.alarm:
        return False
    if search.best.keys:
        return True
    if gain / replicate_inflation(problem, key) < search.alarm:
        return False
    return gain >= config.sure_gain or (
        held_out_gain(problem, key)[0] >= config.held_out_share * gain
    )


def _stands_out(
    problem: FitProblem, search: SearchResult, first: Hypothesis, config: SelectionConfig
) -> bool:
    """Whether a first effect gains enough; where the nominal's form errs, it must also be visible.

    What is known of the size of such an error is no more than a rough figure.
    """
    before = search.best
    if before.cost - first.cost < search.alarm:
        return False
    nominal = problem.model.nominal
    if nominal is None or not nominal.errs:
        return True
    return visibility(problem, before.fit, first.fit) >= config.further_visibility


def _worth_fitting(
    problem: FitProblem,
    before: Hypothesis,
    top: list[str],
    gains: dict[str, float],
    bent: bool,
    config: SelectionConfig,
) -> list[str]:
    """Keys worth a nonlinear fit: the best, and the best that show in channels of their own.

    What an inexact form of a large first effect leaves outweighs a second effect elsewhere. Where
    constants are bent to the ends of their tolerances, linear gains say little.
    """
    least = 0.0 if bent else config.fitted_share
    made = [k for k in top[: config.fitted_candidates] if gains[k] > least * gains[top[0]]]
    own = [k for k in top if own_channels(problem, before.fit, k)] if before.keys else []
    return made + [
        k for k in own[: config.fitted_own_channels]
        if k not in made and gains[k] > least * gains[own[0]]
    ]  # fmt: skip


def _passed(
    problem: FitProblem, search: SearchResult, tried: list[Hypothesis], config: SelectionConfig
) -> tuple[list[Hypothesis], SearchResult]:
    """Further effects that pass the inclusion test; the best one's test is recorded."""
    before = search.best.fit
    relative = min((h.cost for h in tried if same_family(before, h.fit)), default=np.inf)
    tests = []
    for h in tried:
        statistics = step_statistics(
            problem, search.gap, search.alarm, before, h.fit, relative, config=config
        )
        tests.append((statistics, is_included(statistics, config)))
    passed = [h for h, (_, included) in zip(tried, tests, strict=True) if included]
    best = next((test for test in tests if test[1]), tests[0])
    return passed, replace(search, tests=(*search.tests, best))


def _backward_steps(
    problem: FitProblem, previous: SearchResult, search: SearchResult, config: SelectionConfig
) -> SearchResult:
    """Replace two of a family by one, leave out a needless effect, and swap effects."""
    one = one_of_family(problem, search.best, search.gap, search.alarm, config)
    if one is not None:
        rivals = [h for h in search.rivals if h.keys != one.keys]
        search = replace(search, best=one, rivals=rivals, steps=_merged(search.steps, -2))
    if len(search.best.keys) > 1:
        less = drop_needless(problem, search.best, search.alarm, config)
        if less is not None and search.best.keys[-1] not in less.keys:
            rivals = previous.rivals if less.keys == previous.best.keys else []
            return replace(search, best=less, rivals=rivals, steps=_merged(search.steps, -1))
        if less is not None:
            gone = next(k for k, (key, _) in enumerate(search.steps) if key not in less.keys)
            search = replace(search, best=less, rivals=[], steps=_merged(search.steps, gone))
    if len(search.best.keys) > 1:
        search = _swap_step(problem, search, config)
    return search


def _merged(steps: Steps, gone: int) -> Steps:
    """Steps without one of them, its gain added to that of the next, or of the one before."""
    gone %= len(steps)
    if gone == len(steps) - 1:
        key, gain = steps[-2]
        return (*steps[:-2], (key, gain + steps[-1][1]))
    key, gain = steps[gone + 1]
    return (*steps[:gone], (key, gain + steps[gone][1]), *steps[gone + 2 :])


def _swap_step(problem: FitProblem, search: SearchResult, config: SelectionConfig) -> SearchResult:
    """Put a better effect in the place of another; those as good become rivals."""
    others = swapped(problem, search.best, config)
    best, steps = search.best, search.steps
    if others and others[0].cost < best.cost - config.swap_gain:
        steps = tuple((k, gain) for k, (_, gain) in zip(others[0].keys, steps, strict=True))
        best, others = others[0], [*others[1:], best]
    known = {h.fit.ids for h in search.rivals} | {best.fit.ids}
    rivals = [*search.rivals, *(h for h in others if h.fit.ids not in known)]
    return replace(search, best=best, steps=steps, rivals=rivals)


def _polished(
    problem: FitProblem, search: SearchResult, config: SelectionConfig
) -> list[Hypothesis]:
    """Rivals, the near ones fitted to the end: a fit that stopped early looks worse than it is."""
    near = near_cost(problem, search.best.cost, config)
    rivals = sorted(search.rivals, key=lambda h: h.cost)
    made = [
        Hypothesis(h.keys, problem.polish(h.fit))
        if at < config.rivals_in_best_form and h.cost < near
        else h
        for at, h in enumerate(rivals)
    ]
    return sorted(made, key=lambda h: h.cost)


def _scan_clocks(problem: FitProblem, config: SelectionConfig) -> dict[str, tuple[float, float]]:
    """Gain and amount of whole clock offsets, too large for a sensitivity to show."""
    found: dict[str, tuple[float, float]] = {}
    for candidate in problem.candidates:
        if candidate.search.scan != "clock":
            continue
        best = (0.0, 0.0)
        for start in (problem.base.shift, np.zeros(len(problem.names))):
            for size in config.scan_clocks_ms:
                for way in (1.0, -1.0):
                    best = max(best, _gain_of(problem, start, candidate, way * size))
            step = 0.2 * abs(best[1])
            while best[0] > 0.0 and step > 1.0:
                near = (best[1] + step, best[1] - step)
                best = max(best, *(_gain_of(problem, start, candidate, x) for x in near))
                step *= 0.6
        if best[0] > 0.0:
            found[candidate.key] = best
    return found


def _scan_delays(problem: FitProblem, config: SelectionConfig) -> dict[str, tuple[float, float]]:
    """Gain and amount of valve delays in tests that a controller made.

    The pulses of a controller may be shorter than the delay, and then do nothing at all: the
    sensitivity at one millisecond does not show a delay of twenty. Nor does a delay of twenty
    where the constants have moved to what such pulses leave: it is tried at the stated ones too.
    """
    found = {}
    starts = (problem.base.shift, np.zeros(len(problem.names)))
    for candidate in problem.candidates:
        if candidate.search.scan == "delay":
            tried = [
                _gain_of(problem, start, candidate, size)
                for start in starts
                for size in config.scan_delays_ms
            ]
            found[candidate.key] = max(tried)
    return {key: best for key, best in found.items() if best[0] > 0.0}


def _gain_of(
    problem: FitProblem, shift: Array, candidate: Candidate, amount: float
) -> tuple[float, float]:
    """Gain of a candidate at a fixed amount, and the amount."""
    cost = problem.cost_at(shift, (candidate,), np.array([amount]))
    return problem.base.cost - cost, amount


def why_not(problem: FitProblem, search: SearchResult, named: set[str]) -> dict[str, WhyNot]:
    """Why each entry of the catalogue that is not in the set was not chosen."""
    made: dict[str, WhyNot] = {}
    rivals = {c.fit.ids[-1]: c for c in reversed(search.rivals)}
    for candidate in problem.candidates:
        name = candidate.id
        if candidate.defect or name in named or name in made:
            continue
        gains = [g for key, g in search.first_gain.items() if key.split(":")[0] == name]
        gain = max(gains, default=0.0)
        if not any(block in problem.grid.points for block in candidate.blocks):
            made[name] = WhyNot(Rejection.NO_CHANNEL)
        elif name in rivals and search.best.keys:
            made[name] = WhyNot(Rejection.WORSE_FIT, rivals[name].cost - search.best.cost)
        elif search.gap > 1.0:
            made[name] = WhyNot(Rejection.SMALL_SHARE, min(gain / search.gap, 1.0))
        else:
            made[name] = WhyNot(Rejection.SMALL_GAIN, gain)
    return made
