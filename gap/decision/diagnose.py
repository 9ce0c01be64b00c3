"""From a data set to a verdict: the public entry of the diagnosis.

verdict = diagnose(read_dataset("folder"))
verdict.status, [effect.ids for effect in verdict.effects]
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from daq.progress import stage
from gap.data.dataset import DataSet
from gap.data.quality import Unfit, unfit_channels
from gap.decision.classify import classify
from gap.decision.config import DECISION
from gap.effects.candidates import CANDIDATES, Candidate
from gap.effects.terms import OF_TRIAL
from gap.errors import GapError
from gap.estimation.fit_problem import FitProblem, FitResult
from gap.estimation.fitness import UnfitPlant, beyond_braid, doubts, doubts_left
from gap.estimation.standards import StandardCheck, with_known_errors
from gap.reason import Cause, Reason, reason
from gap.selection.config import SELECTION
from gap.selection.further import with_further
from gap.selection.inclusion import excess_chi2
from gap.selection.search import SearchResult, search_effects
from gap.selection.timing import channel_with_timing_fault, in_time
from gap.validation.empirical import empirical_term
from gap.verdict import Estimate, Explanation, Rejection, Status, Verdict, WhyNot
from plant.arrays import Array
from plant.effects.arguments import Context
from plant.effects.catalogue import CATALOGUE


def diagnose(data: DataSet, without: Iterable[str] = ()) -> Verdict:
    """Name the effect behind the gap of a data set, or say why it cannot be named.

    `without` strikes effects from the catalogue, as a check of how the rest takes their place.

    Raises:
        GapError: an unknown effect in `without`, or a data set in which nothing can be compared.
    """
    return diagnose_with_fit(data, without)[0]


def diagnose_with_fit(
    data: DataSet, without: Iterable[str] = ()
) -> tuple[Verdict, FitProblem | None, FitResult | None]:
    """Diagnose, and hand back the fits behind the verdict as well; see `diagnose`.

    The fit holds what the verdict speaks of: without what the search could not prove.
    """
    verdict, problem, search = diagnose_with_search(data, without)
    return verdict, problem, search.best.fit if search is not None else None


def diagnose_with_search(
    data: DataSet, without: Iterable[str] = ()
) -> tuple[Verdict, FitProblem | None, SearchResult | None]:
    """Diagnose, and hand back the search behind the verdict as well; see `diagnose`.

    FitProblem and search are None where the data are unfit or nothing can be compared.
    """
    verdict, problem, search = diagnose_without_term(data, without)
    if problem is not None and search is not None:
        verdict = with_empirical_term(verdict, problem, search)
    return verdict, problem, search


def diagnose_without_term(
    data: DataSet, without: Iterable[str] = ()
) -> tuple[Verdict, FitProblem | None, SearchResult | None]:
    """The diagnosis without the term for what it has no name for; see `diagnose_with_search`."""
    known, check = with_known_errors(data)
    verdict, problem, search = verdict_by_catalogue(known, (*without, *check.cleared))
    if problem is None or search is None:
        return with_standards(verdict, check), None, None
    return with_standards(verdict, check), problem, search


def verdict_by_catalogue(
    data: DataSet, without: Iterable[str] = ()
) -> tuple[Verdict, FitProblem | None, SearchResult | None]:
    """The verdict that takes no reading of a reference standard; see `diagnose_without_term`."""
    candidates = candidates_without(without)
    unfit = unfit_channels(data)
    if unfit:
        return _unfit(unfit), None, None
    stage(f"noise and recalibration of {len(data.trials)} trials")
    problem = FitProblem.of(data, candidates)
    if not len(problem.rows):
        return nothing_to_compare(data), None, None
    outside, doubtful = beyond_braid(problem), doubts(problem, problem.base)
    if outside:
        return _unfit_plant(data, [*outside, *doubtful]), None, None
    if excess_chi2(problem, problem.base) > SELECTION.timing_excess_per_row * len(problem.rows):
        timing_fault = channel_with_timing_fault(problem)
        if timing_fault is not None:
            if doubtful:  # a channel out of time moves the constants of the muscle as well
                put_right = FitProblem.of(in_time(data, timing_fault), candidates)
                doubtful = doubts(put_right, put_right.base)
            if doubtful:
                return _unfit_plant(data, doubtful), None, None
            return _unfit([Unfit(timing_fault.channel, timing_fault.defect)]), None, None
    found = search_effects(problem)
    if np.any(np.abs(problem.base.shift[len(problem.names) - problem.own :]) > _MADE_UP_SD):
        problem, found = _run_where_less_is_left(problem, found)
    if doubtful:
        # Several large effects do this as well as another muscle: all of them must be in.
        found = with_further(problem, found)
    stage("confounders, stages and the next experiment")
    verdict, search = classify(problem, found)
    if doubtful:
        left = doubts_left(problem, found.best.fit, found.gap, found.left)
        if left or not has_sure_effect(verdict):
            return _unfit_plant(data, left or doubtful), None, None
    verdict = with_scales(verdict, problem, search.best.fit)
    return with_effects_by_trial(verdict, problem), problem, search


_MADE_UP_SD = 3.0
"""Shift of a simulator's parameter, in sd, that may make up for an effect. A matter of definition.
"""


_WORTH_OF_LEFT = 0.1
"""Share of what the first run leaves that another one must explain. No other value was tried."""


def _run_where_less_is_left(
    problem: FitProblem, found: SearchResult
) -> tuple[FitProblem, SearchResult]:
    """The search with the simulator run as recalibrated, or as stated: what leaves less.

    Either the parameters are off, or an effect has moved them.
    """
    stated = problem.run_as_stated()
    if stated is problem:
        return problem, found
    again = search_effects(stated)
    fewer = found.alarm * (len(found.best.keys) - len(again.best.keys))
    gained = found.best.cost + fewer - again.best.cost
    # Away from where it runs a simulator is a straight line only: a little is no reason.
    worth = found.alarm + _WORTH_OF_LEFT * found.left
    return (stated, again) if gained > worth else (problem, found)


def has_sure_effect(verdict: Verdict) -> bool:
    """Whether effects are named of which one at least is sure by itself.

    Without one, a plant that was in doubt may be another muscle after all. Set on: sets 934 to 1052
    of the stream `several`: beside such a one 7 of 7 effects between 0.8 and 0.9 were there, of
    plants whose effects left no doubt; without one 0 of 2.
    """
    presence = verdict.evidence.get("presence")
    odds = {one["id"]: one["probability"] for one in presence} if isinstance(presence, list) else {}
    return any(odds.get(name, 0.0) >= DECISION.present for name in verdict.sure)


_NEAREST = 3


def fit_below_term(verdict: Verdict, problem: FitProblem, search: SearchResult) -> FitResult:
    """The fit that an empirical term of the verdict is added to."""
    return search.best.fit if verdict.status.explained else problem.base


def with_empirical_term(verdict: Verdict, problem: FitProblem, search: SearchResult) -> Verdict:
    """The verdict with what the gap looks like that it has no name, or no adequate form, for."""
    if verdict.status not in (Status.UNKNOWN, Status.NAMED_FORM_INADEQUATE):
        return verdict
    stage("what the gap looks like")
    fit = fit_below_term(verdict, problem, search)
    ids = {s.key: s.id for s in problem.candidates if not s.defect}
    gains = sorted((k for k in search.first_gain if k in ids), key=lambda k: -search.first_gain[k])
    near = list(dict.fromkeys(ids[k] for k in gains if ids[k] not in fit.ids))[:_NEAREST]
    refused = None if verdict.status.explained else search.best.fit
    return replace(verdict, empirical=empirical_term(problem, fit, near, refused=refused))


_SCALE_AT = (0.05, 1.0 / 3.0, 2.0 / 3.0, 1.0)
"""Shares of the true value behind the largest reading at which a note gives the error of a scale
that changes."""
_SCALE_STEPS = 401
"""Values among which that one is sought; a note has three digits."""


def _off(
    true: Array, own: Sequence[tuple[Candidate, float]], bend: Any, read: Any, context: Context
) -> Array:
    """What a sensor shows too much at true values, by the parts of one effect."""
    parts = [
        bend(true, float(a), s.shape, context) if s.shape else read(float(a))[0] * true
        for s, a in own
    ]
    return np.asarray(np.sum(parts, axis=0))


def with_scales(verdict: Verdict, problem: FitProblem, fit: FitResult) -> Verdict:
    """The verdict with a note on each scale of an explanation that changes over the range."""
    context = problem.model.context(problem.constants(fit.shift), fit.active)
    offered = {name for entry in verdict.effects for name in entry.ids}
    notes = []
    for name in (name for name in fit.ids if name in offered and name in CATALOGUE):
        on, sensors = CATALOGUE[name].diagnosis, CATALOGUE[name].sensors
        own = [s for s in zip(fit.candidates, fit.amounts, strict=True) if s[0].id == name]
        for bend, read, full, unit, si in (
            (on.pressure_linearity, sensors.pressure, context.full_pa, "kPa", 1e-3),
            (on.force_linearity, sensors.force, context.full_n, "N", 1.0),
        ):
            if bend is None or read is None or not any(s.shape for s, _ in own):
                continue
            true = np.linspace(0.0, 2.0 * full, _SCALE_STEPS)
            shown = true + _off(true, own, bend, read, context)
            top = np.interp(full, np.maximum.accumulate(shown), true)
            at = np.array(_SCALE_AT) * top
            percent = 100.0 * _off(at, own, bend, read, context) / at
            told = ", ".join(
                f"{p:.3g} % at {value * si:.3g} {unit}"
                for p, value in zip(percent, at, strict=True)
            )
            notes.append(f"{name} changes over the range of the sensor: {told}")
        notes += _label_notes(problem, name, own, context)
    return replace(verdict, notes=(*notes, *verdict.notes)) if notes else verdict


def _label_notes(
    problem: FitProblem, name: str, own: Sequence[tuple[Candidate, float]], context: Context
) -> list[str]:
    """A note on labels whose error changes with the length, over the lengths of the data."""
    effect = CATALOGUE[name]
    held, changes = effect.sensors.held, effect.sensors.scale_changes
    as_plant, headline = effect.search.as_plant, effect.headline
    if held is None or changes is None or as_plant is None or headline is None:
        return []
    values = {p.name: p.default for p in effect.parameters if p.default is not None}
    values |= {headline: sum(amount for _, amount in own), **as_plant(own[0][0].shape, context)}
    written = [t.held_length_mm for t in problem.data.trials if np.isfinite(t.held_length_mm)]
    if not written or not changes(values):
        return []
    at = np.unique([min(written), 0.5 * (min(written) + max(written)), max(written)])
    off = held(at * 1e-3, values, context.constants) * 1e3
    told = ", ".join(f"{o:.2g} mm at {x:.4g} mm" for o, x in zip(off, at, strict=True))
    return [f"{name} changes with the length: {told}"]


_TRIALS_SHOWN = 6
"""Trials that a note names."""


def with_effects_by_trial(verdict: Verdict, problem: FitProblem) -> Verdict:
    """The verdict with a note for each effect of which some trials have more than their replicates.

    Where nothing else is a gap, such an effect is what the data show.
    """
    amounts: dict[str, dict[str, float]] = {}
    for name, _, amount, shape in problem.by_trial:
        trial = problem.data.trials[int(shape[OF_TRIAL])].name
        amounts.setdefault(name, {})[trial] = amount
    if not amounts:
        return verdict
    notes = tuple(_note_by_trial(name, own) for name, own in amounts.items())
    verdict = replace(verdict, notes=(*notes, *verdict.notes))
    if verdict.status is not Status.NO_GAP_ABOVE_FLOOR:
        return verdict
    names = tuple(amounts)
    found: dict[str, Estimate] = {}
    for name, own in amounts.items():
        effect = CATALOGUE[name]
        if effect.headline is not None:
            found[effect.headline] = Estimate(max(own.values()))
    first = CATALOGUE[names[0]]
    count = len({trial for own in amounts.values() for trial in own})
    known = 1.0 - verdict.probability_unknown
    return replace(
        verdict,
        status=Status.NAMED,
        reason=reason(
            Cause.BY_TRIAL, names=" and ".join(names), count=count, trials=len(problem.data.trials)
        ),
        stage=first.stage,
        effects=(Explanation(names, first.family, known, found),),
        probability_none=0.0,
        sure=names,
    )


def _note_by_trial(name: str, amounts: dict[str, float]) -> str:
    """One line with the trials, those with most first."""
    effect = CATALOGUE[name]
    unit = next((p.unit for p in effect.parameters if p.name == effect.headline), "")
    most = sorted(amounts, key=lambda trial: -amounts[trial])
    told = ", ".join(f"{trial} {amounts[trial]:.2g}" for trial in most[:_TRIALS_SHOWN])
    more = f" and {len(most) - _TRIALS_SHOWN} more" if len(most) > _TRIALS_SHOWN else ""
    return (
        f"{name} differs between replicates: beyond the one that has least, {told}{more} {unit}; "
        "the fit gives each its own"
    )


def with_standards(verdict: Verdict, check: StandardCheck) -> Verdict:
    """The verdict with the errors of instruments that reference standards show.

    They were measured by themselves, so they stand beside whatever explains the rest; where nothing
    is left to explain, they are what the data show.
    """
    if not check.measured:
        return verdict
    evidence: dict[str, Any] = {
        "shown": {name: {"value": value, "u": u} for name, (value, u) in check.errors.items()},
        "cleared": list(check.cleared),
    }
    verdict = replace(
        verdict,
        why_not={**verdict.why_not, **{n: WhyNot(Rejection.CLEARED) for n in check.cleared}},
        evidence={**verdict.evidence, "standards": evidence},
    )
    if not check.shown:
        return verdict
    names, first = check.shown, CATALOGUE[check.shown[0]]
    told = " and ".join(names)
    if verdict.status is Status.NO_GAP_ABOVE_FLOOR:
        alone = Explanation((), "", 1.0 - verdict.probability_unknown)
        return replace(
            verdict,
            status=Status.NAMED,
            reason=reason(Cause.STANDARD, names=told),
            stage=first.stage,
            effects=(_with_shown(alone, check),),
            probability_none=0.0,
            sure=names,
        )
    return replace(
        verdict,
        reason=reason(Cause.STANDARD_BESIDE, names=told, rest=str(verdict.reason)),
        effects=tuple(_with_shown(entry, check) for entry in verdict.effects),
        sure=tuple(dict.fromkeys((*names, *verdict.sure))),
    )


def _with_shown(entry: Explanation, check: StandardCheck) -> Explanation:
    """An entry with the errors that standards show in front; what it adds to one counts to it."""
    found: dict[str, Estimate] = {}
    own = dict(entry.parameters)
    for name, (value, u) in check.errors.items():
        headline = str(CATALOGUE[name].headline)
        more = Estimate(0.0, 0.0, 0.0)
        if name in entry.ids:
            key = f"{name}_{headline}" if f"{name}_{headline}" in own else headline
            more = own.pop(key, more)
        off, low, high = (float(x or 0.0) for x in (more.value, more.low, more.high))
        both = Estimate(value + off, value + low - 1.96 * u, value + high + 1.96 * u)
        found = _beside(found, (name,), {headline: both})
    rest = tuple(name for name in entry.ids if name not in check.errors)
    families = [CATALOGUE[name].family for name in check.shown] + entry.family.split("+")
    return Explanation(
        (*check.shown, *rest),
        "+".join(dict.fromkeys(filter(None, families))),
        entry.probability,
        _beside(found, rest, own),
    )


def _beside(
    first: Mapping[str, Estimate], ids: Sequence[str], parameters: Mapping[str, Estimate]
) -> dict[str, Estimate]:
    """Parameters of further effects beside others; one of the same name gets its id in front."""
    made = dict(first)
    for key, value in parameters.items():
        owner = next((name for name in ids if CATALOGUE[name].headline == key), ids[0])
        made[key if key not in first else f"{owner}_{key}"] = value
    return made


def _unfit_plant(data: DataSet, found: list[UnfitPlant]) -> Verdict:
    own = all(one.place.startswith("simulator ") for one in found)
    cause = Cause.SIMULATOR_UNFIT if own else Cause.NOMINAL_UNFIT
    return Verdict(
        status=Status.NOMINAL_UNFIT,
        reason=reason(cause, findings="; ".join(map(str, found))),
        stage=None,
        effects=(),
        probability_none=0.0,
        probability_unknown=1.0,
        notes=data.notes,
        evidence={
            "misfits": [
                {"misfit": one.misfit, "place": one.place, "found": one.found, "limit": one.limit}
                for one in found
            ]
        },
    )


def candidates_without(struck: Iterable[str]) -> list[Candidate]:
    """All candidates but those of some effects. Raises `GapError` for an unknown effect."""
    names = frozenset(struck)
    for name in sorted(names):
        if name not in CATALOGUE:
            raise GapError(
                "--without", f"unknown effect {name!r}", f"known: {', '.join(CATALOGUE)}"
            )
    return [candidate for candidate in CANDIDATES if candidate.id not in names]


def _unfit(found: list[Unfit]) -> Verdict:
    first = found[0]
    return Verdict(
        status=Status.DATA_UNFIT,
        reason=reason(Cause.UNFIT_CHANNELS, defects="; ".join(map(str, found[:3]))),
        stage=None,
        effects=(),
        probability_none=0.0,
        probability_unknown=1.0,
        evidence={
            "unfit": [{"channel": u.channel, "defect": u.defect} for u in found],
            "first": first.trial,
        },
    )


def nothing_to_compare(data: DataSet) -> Verdict:
    """The verdict on data without any two channels that the plant relates."""
    return Verdict(
        status=Status.BELOW_RESOLUTION,
        reason=Reason(Cause.NOTHING_TO_COMPARE),
        stage=None,
        effects=(),
        probability_none=0.5,
        probability_unknown=0.5,
        notes=data.notes,
    )
