"""The verdict on what a search found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations

import numpy as np
from scipy.special import expit, logit

from gap.decision.config import DECISION, DecisionConfig
from gap.decision.confounders import Confounder, ConfounderSearch, plainer_channel
from gap.decision.posterior import credible_set, posterior
from gap.decision.presence import evidence_of, odds_of, only_effects
from gap.decision.reliability import shipped_reliability
from gap.decision.traits import traits_of
from gap.design.advise import advise, more_replicates
from gap.effects.candidates import DEFECTS
from gap.effects.recording import CALIBRATION
from gap.estimation.agreement import shared_chi2
from gap.estimation.cross_validation import HeldOut, gap_of, held_out
from gap.estimation.fit_problem import FitProblem, FitResult
from gap.estimation.intervals import detection_limits, growth_estimates, headline_estimates
from gap.reason import Cause, Reason, reason, rest_of
from gap.selection.candidate_fits import Hypothesis, linear_gains
from gap.selection.config import SELECTION
from gap.selection.further import with_further
from gap.selection.per_stroke import with_per_stroke_delays
from gap.selection.pruning import prune
from gap.selection.search import SearchResult, why_not
from gap.validation.where import contrasts_of, remaining_drift, stage_shares
from gap.verdict import Experiment, Explanation, Gap, Status, Verdict
from plant.constants import KEYS
from plant.effects.catalogue import CATALOGUE

NAMED = (Status.NAMED, Status.NAMED_FORM_INADEQUATE)
ALIKE = (Status.INDISTINGUISHABLE, Status.MIMICABLE)


@dataclass(frozen=True)
class _Case:
    """What a verdict is made from: the fits, the outcome of the search, held-out errors."""

    problem: FitProblem
    search: SearchResult
    config: DecisionConfig

    @cached_property
    def held(self) -> dict[str, HeldOut]:
        """Held-out errors of the best explanation, by block."""
        return held_out(self.problem, self.search.best.fit)

    @property
    def names(self) -> str:
        """The effects of the best explanation."""
        return " and ".join(self.search.best.fit.ids)

    @property
    def chance(self) -> float:
        """One standard deviation of chi-square."""
        return float(np.sqrt(2.0 * len(self.problem.rows)))

    @property
    def shows(self) -> bool:
        """Whether there is more of a gap than chance, over all rows."""
        return self.search.gap > self.chance

    @property
    def leaves_nothing(self) -> bool:
        """Whether the best explanation leaves no more than chance."""
        return self.search.left < self.chance

    @cached_property
    def shared(self) -> float:
        """Chi-square of the recalibrated plant that replicates share."""
        return shared_chi2(self.problem, self.problem.base.residual)

    @cached_property
    def traits(self) -> dict[str, float]:
        """Traits of the best explanation."""
        return traits_of(self.problem, self.search, self.held)

    @cached_property
    def reliability(self) -> dict[str, float]:
        """Probability of each outcome of the best explanation."""
        return shipped_reliability().of(self.traits)

    @property
    def share(self) -> float:
        """Share of the gap that is explained; what chance may leave does not count as left."""
        left = max(self.search.left - self.chance, 0.0)
        return 1.0 - left / max(self.search.gap, 1.0)

    @property
    def floor_source(self) -> str | None:
        """Where the floor comes from; None where there are too few replicates for one.

        The floor of a single run in time holds its noise and what runs usually differ by. On this
        bench that may be more, so only a gap far above it is one.
        """
        if self._replicated:
            return "replicates"
        return "smoothness" if self.problem.data.settled or self.alone else None

    @cached_property
    def alone(self) -> bool:
        """Whether runs in time, without enough replicates, show a gap far above their floor.

        In the fit to all of them as well: where few slots settle a constant, one that is left out
        can be far off.
        """
        if self._replicated or self.problem.data.settled or not self.shows:
            return False
        far, several = self.config.far_above_floor, len(self.problem.data.slots) > 1
        return any(p.errors(several)[0] > far * p.rms("floor") for p in self.held.values())

    @property
    def _replicated(self) -> bool:
        noise = self.problem.noise
        return bool(noise.pairs) and noise.freedom >= self.config.needed_replicates

    def block(self, fit: FitResult) -> str:
        """The block whose gap stands highest above its floor, or is closed most.

        What one slot alone shows is not closed without that slot: where no block's gap is smaller
        on slots left out, it is the one in which the fit to all of them gains most.
        """

        def height(block: str) -> float:
            part = self.held[block]
            gained = part.rms("recalibrated") ** 2 - (
                part.rms("after") ** 2 if fit.candidates else part.rms("floor") ** 2
            )
            sure = not fit.candidates or part.closed() is not None
            return _over_floor(block, part, gained) * (1.0 if sure else 0.1)

        def height_inside(block: str) -> float:
            part = self.held[block]
            assert part.fitted is not None
            before, after = (float(squares.sum()) for squares in part.fitted)
            return _over_floor(block, part, (before - after) / max(float(part.weight.sum()), 1e-12))

        best = max(self.held, key=height)
        if fit.candidates and height(best) <= 0.0:
            return max(self.held, key=height_inside)
        return best

    def nearest_stage(self, block: str) -> str | None:
        """Stage of the candidate with the largest gain among those that touch the block."""
        known = {s.key: s for s in self.problem.candidates if not s.defect and block in s.blocks}
        gains = {k: g for k, g in self.search.first_gain.items() if k in known}
        if not gains:
            return None
        stage = CATALOGUE[known[max(gains, key=lambda k: gains[k])].id].stage
        return None if stage == "any" else stage


def _over_floor(block: str, part: HeldOut, squares: float) -> float:
    """Squared errors of a block in those of its floor; those of the camera count less."""
    floor = max(part.rms("floor"), 1e-6) ** 2
    return squares / floor * (0.2 if block == "camera" else 1.0)


@dataclass(frozen=True)
class _Finding:
    """Status, reason and probabilities of a verdict, with the explanations that it offers."""

    status: Status
    reason: Reason
    none: float
    unknown: float
    named: bool = False
    stage: str | None = None
    entries: list[tuple[Hypothesis, float]] = field(default_factory=list)
    confounders: list[Confounder] = field(default_factory=list)
    evidence: dict[str, object] = field(default_factory=dict)
    sure: tuple[str, ...] = ()
    leads: bool = False
    """Whether the first entry comes first although another may be more probable."""


def classify(
    problem: FitProblem, search: SearchResult, config: DecisionConfig = DECISION
) -> tuple[Verdict, SearchResult]:
    """Turn the outcome of a search into a verdict; also return the search after pruning."""
    outcome = prune(problem, search)
    case = _Case(problem, with_per_stroke_delays(problem, outcome.search), config)
    if outcome.defect:
        finding = _defect(case)
    elif outcome.uncertain_defect:
        finding = _unknown(case, case.search.best.fit, 1.0, Reason(Cause.UNCERTAIN_DEFECT))
    elif not case.shows and set(_undetermined(case, case.search.best.fit)) == set(
        case.search.best.fit.ids
    ):
        # Nothing shows, and what an effect at the end of its range takes is noise.
        finding = _unexplained(case)
    elif case.search.best.keys:
        further = with_further(problem, case.search)
        case = _judged(case, further)
        evidence = evidence_of(problem, further, case.reliability["unknown"])
        odds = odds_of(evidence)
        case, finding = _by_presence(case, _explained(case), further, odds)
        presence = [{**one.as_dict(), "probability": odds[one.id]} for one in evidence]
        finding = replace(finding, evidence={**finding.evidence, "presence": presence})
        finding = _unless_plainer(case, _with_calibration(case, finding), further)
    else:
        finding = _unexplained(case)
    return _verdict(case, _without_replicates(case, finding)), case.search


def _judged(case: _Case, further: SearchResult) -> _Case:
    """The case with further effects, where these make it less like an effect nobody knows.

    Two large effects leave what a third and a fourth do, and what is left looks like something
    outside the catalogue until they are in. What is refused all the same is not made longer.
    """
    if further.best is case.search.best:
        return case
    gains = linear_gains(case.problem, further.best.fit).by_key()
    wider = replace(case, search=replace(further, last_gain=gains))
    most = min(case.config.unknown, case.reliability["unknown"])
    return wider if wider.reliability["unknown"] < most else case


def _unknown(case: _Case, fit: FitResult, unknown: float, why: Reason) -> _Finding:
    """A gap without a name, at the stage of the nearest candidate."""
    stage = case.nearest_stage(case.block(fit))
    return _Finding(Status.UNKNOWN, why, 1.0 - unknown, unknown, stage=stage)


def _defect(case: _Case) -> _Finding:
    """A defect of the recording explains the gap."""
    fit = case.search.best.fit
    candidate, amount = fit.candidates[0], float(fit.amounts[0])
    name = candidate.id
    cause = Cause.DEFECT_IN_TIME if candidate.search.scan == "clock" else Cause.DEFECT
    return _Finding(
        Status.DATA_UNFIT, reason(cause, meaning=DEFECTS[name], amount=amount), 0.0, 1.0,
        evidence={"defect": name, "amount": amount},
    )  # fmt: skip


def _unexplained(case: _Case) -> _Finding:
    """No effect reached the alarm: too few replicates, an unknown gap, or none."""
    problem, search, config = case.problem, case.search, case.config
    too_few = _Finding(
        Status.BELOW_RESOLUTION,
        reason(
            Cause.TOO_FEW_REPLICATES, freedom=problem.noise.freedom,
            needed=config.needed_replicates,
        ),
        0.5, 0.5,
    )  # fmt: skip
    if case.floor_source is None:
        return too_few
    unseen = search.gap
    if case.floor_source == "replicates":
        # What replicates do not share is noise, whatever the model of the noise states.
        unseen = min(unseen, max(case.shared, 0.0))
    sure = unseen > config.unexplained_chance * case.chance
    unseen /= max(len(problem.rows), 1)
    if sure and unseen > config.unexplained_per_row:
        why: Reason | None = reason(Cause.UNEXPLAINED, block=case.block(problem.base))
    else:
        why = _hidden_gap(case)
    if why is not None:
        return _unknown(case, problem.base, 0.98, why)
    if case.alone:
        return too_few
    best = max(search.first_gain.values(), default=0.0)
    unknown = 0.02 + 0.2 * min(unseen / config.unexplained_per_row, 1.0) ** 2
    none = (1.0 - unknown) * (1.0 - 0.15 * min(best / SELECTION.least_gain, 1.0))
    none *= 1.0 - config.too_small
    return _Finding(Status.NO_GAP_ABOVE_FLOOR, Reason(Cause.NO_GAP), none, 1.0 - none)


def _hidden_gap(case: _Case) -> Reason | None:
    """What shows a gap although no effect explains it; None where nothing does.

    A constant at the end of its tolerance, what replicates share, or a contrast: replicates far
    apart in time take a drift for noise, and their order shows it.
    """
    problem, config = case.problem, case.config
    shift = np.abs(problem.base.shift[: len(problem.names) - problem.unnamed])
    far = shift.max(initial=0.0) > config.at_bound_sd
    if far and case.search.gap > config.at_bound_chance * case.chance:
        constant = problem.names[int(np.argmax(shift))]
        return reason(Cause.CONSTANT_FAR, constant=constant)
    if min(case.shared, case.search.gap) > config.shared_chance * case.chance:
        return reason(Cause.REPLICATES_SHARE, sd=case.shared / case.chance)
    alarm = next((c for c in contrasts_of(problem) if c.alarm), None)
    if alarm is not None:
        return reason(Cause.CONTRAST, name=alarm.name, z=alarm.z)
    return None


def _explained(case: _Case) -> _Finding:
    """The search has an explanation: named, one of several, or unknown after all."""
    problem, search, config = case.problem, case.search, case.config
    fit, names = search.best.fit, case.names
    if case.floor_source is None:
        return _Finding(
            Status.BELOW_RESOLUTION,
            reason(Cause.LOOKS_LIKE, names=names, freedom=problem.noise.freedom),
            0.3, 0.5, named=True,
        )  # fmt: skip
    reliability = case.reliability
    found = posterior(search, reliability, min(search.chance, 0.5), config)
    one, two = _confounders(case)
    finding = _Finding(
        Status.UNKNOWN,
        reason(Cause.OUTSIDE, names=names, percent=100 * case.share),
        found.none,
        found.unknown,
        named=True,
        stage=case.nearest_stage(case.block(fit)),
        entries=found.entries,
        confounders=[
            m for m in (one, two)
            if m and m.share >= config.confounder_share and not _ruled_out(case, m)
        ],
        evidence={
            "found": list(fit.ids),
            "share_explained": case.share,
            "belief": reliability,
            "mimics": [{"ids": m.ids, "share": m.share} for m in (one, two) if m],
            "steps": [{"entry": k, "gain": g} for k, g in search.steps],
            "further": [test.as_dict(included) for test, included in search.tests],
            "traits": case.traits,
        },
    )  # fmt: skip
    if reliability["unknown"] > config.unknown:
        return finding
    drift = remaining_drift(problem, fit)
    if drift is not None:
        return replace(
            finding,
            unknown=max(found.unknown, config.drift_unknown),
            reason=reason(Cause.DRIFT_LEFT, names=names, name=drift.name, z=drift.z),
        )
    entries = [e for e in credible_set(found, config) if not _undetermined(case, e[0].fit)]
    if not entries:
        return replace(
            finding,
            unknown=max(found.unknown, config.unknown),
            reason=reason(Cause.UNDETERMINED, names=names),
        )
    alike = [
        None if m is None or _told_apart(case, m) else m
        for m in (nearest_confounder(search, problem.base.cost, one), two)
    ]
    status, why = _status(case, entries, *alike)
    right, partly = reliability["right"], reliability["right"] + reliability["part"]
    several = len(fit.ids) > 1
    unlikely = partly < (config.named_several if several else config.named)
    if status in NAMED and (unlikely or (several and right < config.named_all)):
        status = Status.INDISTINGUISHABLE
        why = reason(Cause.UNRELIABLE, names=names, percent=100 * right)
    stage = CATALOGUE[fit.ids[0]].stage
    return replace(finding, status=status, reason=why, stage=stage, entries=entries)


def _by_presence(
    case: _Case, finding: _Finding, further: SearchResult, odds: Mapping[str, float]
) -> tuple[_Case, _Finding]:
    """The finding once each effect has been asked for by itself.

    Where an explanation of several effects is refused as a whole, those that are there in any case
    are named, and the rest of the gap stays unknown. Where it is accepted, it goes without effects
    that are rather not there, and with further ones that are; where none of several is there by
    itself, none is named. Where it was not reliable, and is sure with further ones, all are named.
    Where several fit, those on which they agree are sure.

    Args:
        further: the search with further effects beside its best explanation (`with_further`).
        odds: probability of each effect of the best explanation of `further`.
    """
    config = case.config
    wider = replace(case, search=further)
    refused = finding.status is Status.UNKNOWN
    single = len(case.search.best.fit.ids) == 1
    doubtful = not single and case.reliability["unknown"] > config.doubtful_unknown
    of_several = config.present_in_refused if doubtful else config.present_in_several
    usual = config.present if single else of_several
    ids_there = further.best.fit.ids
    if refused:
        likely = tuple(name for name in ids_there if odds[name] >= config.present)
        # The refusal of one effect was learnt on single effects. It says nothing of an explanation
        # of several that leaves a small part of what the one left.
        single = single and further.left > config.beyond_single * case.search.left
        named = None if single else _partly_refused(wider, finding, likely, odds)
        return named or (case, finding)
    sure = _surely_there(ids_there, odds, usual, config)
    if finding.status in NAMED:
        ids = finding.entries[0][0].fit.ids
        kept = _surely_there(ids, odds, of_several, config)
        more = tuple(name for name in sure if name not in ids)
        with_more = _partly(wider, finding, (*kept, *more), odds) if more else None
        if with_more is not None:
            part, found = with_more
            whole = finding.status is Status.NAMED and len(found.sure) == len((*ids, *more))
            return part, _as_whole(part, found) if whole else found
        if len(kept) < len(ids) and len(ids) > 1:
            all_there = float(np.prod([odds.get(name, 0.0) for name in ids]))
            why = reason(Cause.UNRELIABLE, names=case.names, percent=100 * all_there)
            none = replace(finding, status=Status.INDISTINGUISHABLE, reason=why)
            return _partly(case, finding, kept, odds) or (case, none)
        return case, replace(finding, sure=ids)
    found = finding
    if finding.status is Status.INDISTINGUISHABLE and not single:
        if len(finding.entries) == 1 and set(sure) > set(case.search.best.fit.ids):
            # What was not reliable is not the whole: with further effects all are sure.
            return _partly(wider, finding, sure, odds) or (case, finding)
        agreed = [n for n in sure if all(n in h.fit.ids for h, _ in finding.entries)]
        if agreed:
            names = " and ".join(agreed)
            why = reason(Cause.SURE_BESIDE, sure=names, rest=str(finding.reason))
            found = replace(finding, sure=tuple(agreed), reason=why)
    if found.status in ALIKE and len(odds) >= config.many:
        by_itself = _surely_there(ids_there, odds, config.present_in_several, config)
        found = _named_beside(found, by_itself, odds)
    return case, found


def _named_beside(finding: _Finding, sure: tuple[str, ...], odds: Mapping[str, float]) -> _Finding:
    """The finding with effects that are there by themselves, although others fit the whole as well.

    The entries of the set were fitted without further effects: that one of them does without an
    effect of several says less than what the effect does beside all others.
    """
    more = [name for name in sure if name not in finding.sure]
    if not more:
        return finding
    named = (*finding.sure, *more)
    least = 100 * min(odds[name] for name in named)
    rest = finding.reason.values.get("rest", str(finding.reason))
    why = reason(Cause.LIKELY_BESIDE, sure=" and ".join(named), percent=least, rest=rest)
    return replace(finding, sure=named, reason=why)


def _with_calibration(case: _Case, finding: _Finding) -> _Finding:
    """The finding where no effect is sure that the user's own calibration speaks against."""
    stated = case.problem.data.calibration
    fit = finding.entries[0][0].fit if finding.entries else case.search.best.fit
    against: dict[str, tuple[float, str]] = {}
    for candidate, amount in zip(fit.candidates, fit.amounts.tolist(), strict=True):
        key = next((k for k, name in CALIBRATION.items() if name == candidate.id), "")
        if (
            candidate.id in finding.sure
            and key in stated
            and abs(amount) > case.config.against_calibration * stated[key]
        ):
            against[candidate.id] = (abs(amount) / stated[key], key)
    if not against:
        return finding
    sure = tuple(name for name in finding.sure if name not in against)
    name = max(against, key=lambda one: against[one])
    times, key = against[name]
    why = reason(Cause.CALIBRATED, names=name, times=times, key=key)
    return replace(finding, status=Status.INDISTINGUISHABLE, sure=sure, reason=why)


def _without_replicates(case: _Case, finding: _Finding) -> _Finding:
    """The finding with nothing named where nobody knows what runs of one setting differ by."""
    if not case.alone or not (finding.status in NAMED or finding.sure):
        return finding
    names = finding.sure or finding.entries[0][0].fit.ids
    why = reason(Cause.NO_REPLICATES, names=" and ".join(names))
    return replace(finding, status=Status.INDISTINGUISHABLE, reason=why, sure=())


def _unless_plainer(case: _Case, finding: _Finding, further: SearchResult) -> _Finding:
    """The finding where no single number does as much as the several effects of its explanation.

    Args:
        further: the search with further effects beside its best explanation (`with_further`).
    """
    config = case.config
    if finding.status not in (*NAMED, *ALIKE):
        return finding
    channel = plainer_channel(case.problem, further, config)
    if channel is None:
        return finding
    unknown = max(finding.unknown, config.plainer_unknown)
    share = (1.0 - unknown) / max(1.0 - finding.unknown, 1e-9)
    return replace(
        finding,
        status=Status.UNKNOWN,
        reason=reason(Cause.PLAINER, names=" and ".join(further.best.fit.ids), channel=channel),
        unknown=unknown,
        none=finding.none * share,
        entries=[(hypothesis, p * share) for hypothesis, p in finding.entries],
        stage=case.nearest_stage(channel),
        sure=(),
        leads=False,
    )


def _surely_there(
    ids: tuple[str, ...], odds: Mapping[str, float], usual: float, config: DecisionConfig
) -> tuple[str, ...]:
    """Effects that are named: none that is likelier there than a named one stays out."""
    own = [odds.get(name, 0.0) for name in ids]
    least = min(
        (p for name, p in zip(ids, own, strict=True) if p >= _least(name, odds, usual, config)),
        default=np.inf,
    )
    return tuple(name for name, p in zip(ids, own, strict=True) if p >= least)


def _least(name: str, odds: Mapping[str, float], usual: float, config: DecisionConfig) -> float:
    """Least probability with which an effect is named: less beside two that are there."""
    others = sum(p >= config.present for other, p in odds.items() if other != name)
    return config.present_beside_two if others >= _MANY else usual


_MANY = 2
"""Sure effects from which a bench is one with many."""


def _partly_refused(
    case: _Case, finding: _Finding, likely: tuple[str, ...], odds: Mapping[str, float]
) -> tuple[_Case, _Finding] | None:
    """What of a refused explanation is named, or offered where it is only likely to be there.

    None where it explains the smaller part of the gap: the rest, which has no name, may show as it.
    None also where the explanation has many effects: so many together stand for nearly anything.
    """
    if len(case.search.best.fit.ids) > case.config.most_in_refused:
        return None
    sure = tuple(name for name in likely if odds[name] >= case.config.present_in_refused)
    found = _partly(case, finding, sure or likely, odds)
    if found is None or found[0].share < case.config.least_in_refused:
        return None
    if sure:
        return found
    part, offered = found
    right = case.reliability["right"] + case.reliability["part"]
    why = reason(Cause.UNRELIABLE, names=" and ".join(likely), percent=100 * right)
    return part, replace(offered, status=Status.INDISTINGUISHABLE, reason=why, sure=())


def _as_whole(case: _Case, finding: _Finding) -> _Finding:
    """The finding where all that the search found is named, and further effects with it."""
    why = reason(Cause.EXPLAINED, names=case.names)
    return replace(finding, status=Status.NAMED, reason=why)


def _partly(
    case: _Case, finding: _Finding, named: tuple[str, ...], odds: Mapping[str, float]
) -> tuple[_Case, _Finding] | None:
    """Some effects named, all others taken out, and the rest of the gap left unknown.

    An effect whose amount the data do not determine is not named; the others are, and are fitted
    beside it. None where nothing is left to name, or only what corrects the form of an effect that
    is not named: without that one it explains little.
    """
    if not named:
        return None
    search = case.search
    if len(named) < len(search.best.fit.ids):
        search = only_effects(case.problem, search, named)
    part = replace(case, search=search)
    if part.share < case.config.least_of_whole * case.share:
        return None
    undetermined = _undetermined(part, search.best.fit)
    named = tuple(name for name in named if name not in undetermined)
    if not named:
        return None
    probability = float(np.prod([odds[name] for name in named]))
    several = Cause.PARTLY_SEVERAL if len(named) > 1 else Cause.PARTLY
    share = 100 * part.share
    entries = _all_there_is(case, search.best, odds)
    why = reason(
        Cause.PARTLY_OPEN if undetermined else several, names=" and ".join(named),
        percent=100 * probability, share=share, rest=rest_of(share),
        open=" and ".join(undetermined),
    )  # fmt: skip
    return part, replace(
        finding,
        status=Status.NAMED_FORM_INADEQUATE,
        reason=why,
        stage=CATALOGUE[named[0]].stage,
        entries=[(hypothesis, p * (1.0 - finding.none)) for hypothesis, p in entries],
        unknown=(1.0 - sum(p for _, p in entries)) * (1.0 - finding.none),
        confounders=[],
        leads=True,
        sure=named,
    )


def _all_there_is(
    case: _Case, named: Hypothesis, odds: Mapping[str, float]
) -> list[tuple[Hypothesis, float]]:
    """What is named, alone and with others that were found: the probability that it is all.

    That an effect is there does not say that no other is. Each is there or not by a probability of
    its own; what is named comes first, and of the rest the likeliest. The whole is as probable as
    that what is named is there, or less where all of it may stand for something unknown.
    """
    config, whole = case.config, case.search.best
    there = float(np.prod([odds[name] for name in named.fit.ids]))
    beyond = max(1.0 - there, config.beyond_presence * case.reliability["unknown"])
    others = [name for name in whole.fit.ids if name not in named.fit.ids]
    few = len(named.fit.ids) < config.many
    # What the search for further effects has put another in the place of is rather not there.
    there_by = {name: odds.get(name, 0.0) for name in others}
    own = {name: _beside(p, config) if few else p for name, p in there_by.items()}
    sets = {
        with_these: float(np.prod([p if n in with_these else 1.0 - p for n, p in own.items()]))
        for count in range(len(others) + 1)
        for with_these in combinations(others, count)
    }
    made = [(named, (1.0 - beyond) * sets.pop(()))]
    for more in sorted(sets, key=lambda one: -sets[one])[: config.sets_beside]:
        p = (1.0 - beyond) * sets[more]
        if p < config.least_probability:
            break
        kept = (*named.fit.ids, *more)
        all_of_it = len(kept) == len(whole.fit.ids)
        search = case.search if all_of_it else only_effects(case.problem, case.search, kept)
        made.append((search.best, p))
    return made


def _beside(probability: float, config: DecisionConfig) -> float:
    """Probability of an effect beside a named one whose form it may only correct."""
    p = min(max(probability, 1e-6), 1.0 - 1e-6)
    return float(expit(config.beside_constant + config.beside_slope * logit(p)))


def _undetermined(case: _Case, fit: FitResult) -> tuple[str, ...]:
    """Effects of an entry whose amounts the data do not determine.

    They do not where an interval holds the whole range of the catalogue, and no effect with it; nor
    where an amount stands at the end of its range, unless the entry explains the gap nonetheless.
    """
    problem, config = case.problem, case.config
    estimates = headline_estimates(problem, fit, shipped_reliability().form)
    whole = case.share >= config.form_share and case.shows
    explains = fit is case.search.best.fit and whole
    made = []
    for name in fit.ids:
        entry = CATALOGUE[name]
        if entry.headline is None:
            continue
        # With two effects of one parameter name the later has its id in front.
        estimate = estimates.get(f"{name}_{entry.headline}", estimates.get(entry.headline))
        if estimate is None or estimate.low is None or estimate.high is None:
            continue
        low, high = entry.parameters[0].low, entry.parameters[0].high
        neutral = entry.neutral_in(problem.data.constants)
        everywhere = estimate.low < min(low, neutral) and estimate.high > high
        near = config.end_of_range * (high - low)
        ends = [end for end in (low, high) if end != neutral]
        at_end = min(abs(float(estimate.value) - end) for end in ends) < near
        if everywhere or (at_end and not explains):
            made.append(name)
    return tuple(made)


def _confounders(case: _Case) -> tuple[Confounder | None, Confounder | None]:
    """Best single and pair that could stand in for the explanation, by signatures.

    Of several, those that the data rule out are left out.
    """
    fit = case.search.best.fit
    one, two = ConfounderSearch(case.problem).of(
        case.problem.base.residual - fit.residual, frozenset(fit.ids)
    )
    if len(fit.ids) > 1:
        one, two = (None if m and _ruled_out(case, m) else m for m in (one, two))
    return one, two


def nearest_confounder(
    search: SearchResult, base: float, one: Confounder | None
) -> Confounder | None:
    """The confounder `one`, or the rival of the search that takes more at the size that it needs.

    `base` is the cost of the plant without any effect.
    """
    fit = search.best.fit
    whole = max(base - fit.cost, 1e-9)
    for rival in search.rivals if len(fit.ids) == 1 else []:
        taken = 1.0 - (rival.cost - fit.cost) / whole
        if rival.fit.ids != fit.ids and (one is None or taken > one.share):
            one = Confounder(rival.fit.ids, min(taken, 1.0))
    return one


def _told_apart(case: _Case, confounder: Confounder) -> bool:
    """Whether a confounder is ruled out, and not by the form of the effect alone.

    What takes most of the gap of a single effect takes its name away even where the data rule it
    out: told apart by a few per cent of the gap, the name would rest on the exact form. Where the
    effect leaves nothing, its form is exact.
    """
    several = len(case.search.best.fit.ids) > 1
    return (several or case.leaves_nothing) and _ruled_out(case, confounder)


def _ruled_out(case: _Case, confounder: Confounder) -> bool:
    """Whether a confounder leaves more than noise and inexact forms could."""
    config = case.config
    left = (1.0 - confounder.share) * max(case.problem.base.cost - case.search.best.cost, 0.0)
    bearable = max(config.confounder_left, config.confounder_left_factor * case.search.left)
    return confounder.share < config.confounder_sure and left >= bearable


def _status(
    case: _Case,
    entries: list[tuple[Hypothesis, float]],
    one: Confounder | None,
    two: Confounder | None,
) -> tuple[Status, Reason]:
    """Status and reason of an explanation that is reliable."""
    names, least = case.names, case.config.confounder_share
    alike = one is not None and one.share >= least
    if alike or len({frozenset(hypothesis.fit.ids) for hypothesis, _ in entries}) > 1:
        if one is None or not alike:
            return Status.INDISTINGUISHABLE, reason(Cause.SEVERAL_FIT, names=names)
        other = " + ".join(one.ids)
        return Status.INDISTINGUISHABLE, reason(Cause.SEVERAL_ALIKE, names=names, other=other)
    if two is not None and two.share >= least:
        return Status.MIMICABLE, reason(Cause.PAIR_ALIKE, names=names, other=" and ".join(two.ids))
    if case.share < case.config.form_share:
        why = reason(Cause.FORM_LEAVES, names=names, percent=100 * case.share)
        return Status.NAMED_FORM_INADEQUATE, why
    low = _gap(case, named=True).closed_low
    if low is not None and low <= case.config.closed_share:
        return Status.NAMED_FORM_INADEQUATE, reason(Cause.FORM_UNCERTAIN, names=names)
    return Status.NAMED, reason(Cause.EXPLAINED, names=names)


def _gap(case: _Case, named: bool) -> Gap:
    """The gap of the block that shows it best."""
    block = case.block(case.search.best.fit)
    scheme = "slot" if len(case.problem.data.slots) > 1 else None
    return gap_of(block, case.held[block], named, case.floor_source, scheme)


def _verdict(case: _Case, finding: _Finding) -> Verdict:
    """Complete a finding: gap, stages, limits and the next experiment."""
    problem, search = case.problem, case.search
    none, unknown = finding.none, finding.unknown
    effects = _explanations(problem, case.config, finding)
    whole = none + unknown + sum(effect.probability for effect in effects)
    scale = 1.0 / whole if whole > 0.0 else 1.0
    gap = _gap(case, finding.named) if case.held else None
    return Verdict(
        status=finding.status,
        reason=finding.reason,
        stage="muscle" if finding.stage == "any" else finding.stage,  # wear shows in the pull
        effects=tuple(replace(e, probability=e.probability * scale) for e in effects),
        probability_none=none * scale,
        probability_unknown=unknown * scale,
        gap=gap,
        channels=_channels(case, finding.named),
        stages=stage_shares(problem, search.best.fit, case.held) if case.held else (),
        contrasts=contrasts_of(problem),
        limits=detection_limits(problem, SELECTION.least_gain),
        next_experiment=_next_experiment(case, finding),
        why_not=why_not(problem, search, {i for e in effects for i in e.ids}),
        notes=(*problem.data.notes, *_of_the_gap(case, gap), *_shifted_constants(case)),
        evidence={"found": list(search.best.fit.ids), **finding.evidence},
        sure=finding.sure,
    )


def _channels(case: _Case, named: bool) -> tuple[Gap, ...]:
    """The gaps of all blocks, the largest for the range of its channel first.

    Large: what was closed where an effect is named, else what is above the floor, else what there
    was without a fit. Where the effect closes no gap on slots left out, the block that its fit
    helps most comes first.
    """
    scheme = "slot" if len(case.problem.data.slots) > 1 else None
    closes = any(part.rms("after") < part.rms("recalibrated") for part in case.held.values())
    helped = case.block(case.search.best.fit) if named and not closes else None
    found: list[tuple[bool, float, Gap]] = []
    for block, part in case.held.items():
        gap = gap_of(block, part, named, case.floor_source, scheme)
        if named and gap.after is not None:
            size = gap.recalibrated**2 - gap.after**2
        else:
            size = gap.recalibrated**2 - (gap.floor or 0.0) ** 2
        size = float(np.sqrt(size)) if size > 0 else gap.before * 1e-3
        found.append((block == helped, size / _range_of(case.problem, block), gap))
    return tuple(one[2] for one in sorted(found, key=lambda one: (not one[0], -one[1])))


CHANNEL_OF = {
    "pressure": "pressure_kpa", "force": "force_n", "load": "force_n", "camera": "length_mm",
}  # fmt: skip


def _range_of(problem: FitProblem, block: str) -> float:
    """Range of the measured channel of a block over all trials, in its unit."""
    values = [trial.get(CHANNEL_OF[block]).value for trial in problem.data.trials]
    values = [part[np.isfinite(part)] for part in values if len(part)]
    found = [(float(part.min()), float(part.max())) for part in values if len(part)]
    if not found:
        return 1.0
    return max(max(high for _, high in found) - min(low for low, _ in found), 1e-9)


def _next_experiment(case: _Case, finding: _Finding) -> Experiment | None:
    """What to measure next: missing replicates first, else what tells rivals apart."""
    if finding.status is Status.BELOW_RESOLUTION or case.alone:
        return more_replicates(case.problem, case.config.needed_replicates)
    best = finding.entries[0][0].fit if finding.entries else None
    return advise(case.problem, best, _to_tell_apart(case, finding))


def _of_the_gap(case: _Case, gap: Gap | None) -> tuple[str, ...]:
    """Notes where the floor rests on single runs, and where a recalibration makes things worse."""
    made = []
    if case.alone:
        made.append(
            f"{case.problem.noise.freedom} replicates beyond the first: the floor is the noise "
            "within each run and what runs of a bench usually differ by, not what those of this "
            "bench do"
        )
    if (
        gap is not None
        and gap.held_out is not None
        and gap.recalibrated > case.config.worse_recalibrated * gap.before
    ):
        made.append(
            f"recalibrated to the other {gap.held_out}s, the plant predicts a {gap.held_out} worse "
            "than as stated: these data settle its constants less well than they are stated"
        )
    return tuple(made)


def _shifted_constants(case: _Case) -> tuple[str, ...]:
    """Notes on stated constants that the fit moved beyond what their tolerance allows."""
    problem, fit = case.problem, case.search.best.fit
    made = []
    moved, stated = problem.constants(fit.shift), problem.data.constants
    values = problem.simulator_values(fit.shift)
    for name, sd in zip(problem.names, fit.shift.tolist(), strict=True):
        if abs(sd) < case.config.at_bound_sd:
            continue
        if name in KEYS:
            ends = f"stated {stated.value(name):.4g}, in the fit {moved.value(name):.4g}"
        elif name.startswith("simulator "):
            ends = f"in the fit {values[name.removeprefix('simulator ')]:.4g}"
        else:
            continue
        made.append(f"{name} stands {abs(sd):.1f} sd from its stated value ({ends}): check it")
    return tuple(made)


def _to_tell_apart(case: _Case, finding: _Finding) -> list[FitResult]:
    """Fits that an experiment should tell from the best one."""
    if not finding.entries:
        return []
    others = [hypothesis.fit for hypothesis, _ in finding.entries[1:]]
    if finding.leads:
        others = others[:1]  # whether what is likeliest beside it acts as well
    others += [case.problem.fit_effects(confounder.ids) for confounder in finding.confounders]
    return others or [c.fit for c in case.search.rivals[:1]]


def _explanations(
    problem: FitProblem, config: DecisionConfig, finding: _Finding
) -> list[Explanation]:
    """Entries of the set with their parameters; those of the same effects are joined."""
    made: dict[frozenset[str], Explanation] = {}
    for hypothesis, p in finding.entries:
        ids = hypothesis.fit.ids
        kept = made.get(frozenset(ids))
        if kept is not None:
            made[frozenset(ids)] = replace(kept, probability=kept.probability + p)
            continue
        form = shipped_reliability().form
        estimates = headline_estimates(problem, hypothesis.fit, form)
        estimates |= growth_estimates(problem, hypothesis.fit, form)
        made[frozenset(ids)] = Explanation(ids, _families(ids), p, estimates)
    # On these data nothing tells a confounder from the best entry.
    for confounder in finding.confounders:
        if made and frozenset(confounder.ids) not in made:
            p = config.confounder_weight * next(iter(made.values())).probability
            made[frozenset(confounder.ids)] = Explanation(
                confounder.ids, _families(confounder.ids), p, {}
            )
    first = next(iter(made), frozenset()) if finding.leads else frozenset()
    return sorted(made.values(), key=lambda e: (set(e.ids) != first, -e.probability))


def _families(ids: tuple[str, ...]) -> str:
    return "+".join(dict.fromkeys(CATALOGUE[name].family for name in ids))
