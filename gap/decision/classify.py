"""The verdict on what a search found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gap.decision.config import DECISION
from gap.decision.confounders import Confounder, ConfounderSearch
from gap.decision.posterior import credible_set, posterior
from gap.decision.reliability import learnt
from gap.decision.traits import traits_of
from gap.design.advise import advise
from gap.effects.candidates import DEFECTS
from gap.estimation.agreement import shared_chi2
from gap.estimation.cross_validation import HeldOut, gap_of, held_out
from gap.estimation.fit_problem import FitProblem, FitResult
from gap.estimation.intervals import detection_limits, headline_estimates
from gap.selection.candidate_fits import Hypothesis
from gap.selection.config import SELECTION
from gap.selection.per_stroke import with_per_stroke_delays
from gap.selection.pruning import PruningResult, prune
from gap.selection.search import SearchResult, why_not
from gap.validation.where import contrasts_of, drifting, stage_shares
from gap.verdict import Explanation, Gap, Verdict
from plant.effects.catalogue import CATALOGUE


def classify(problem: FitProblem, search: SearchResult) -> tuple[Verdict, SearchResult]:
    """Turn the outcome of a search into a verdict, and say which explanation it rests on."""
    outcome = prune(problem, search)
    outcome = replace(outcome, search=with_per_stroke_delays(problem, outcome.search))
    return _classified(problem, outcome), outcome.search


def _classified(problem: FitProblem, outcome: PruningResult) -> Verdict:
    search = outcome.search
    held = held_out(problem, search.best.fit)
    if outcome.defect:
        return _defect(problem, search, held)
    if outcome.uncertain_defect:
        return _verdict(
            problem, search, held, "unknown",
            "a gap that a fault of the recording would explain better than any effect, but the "
            "trials do not agree on the fault", none=0.0, unknown=1.0,
            stage=_stage_of_block(problem, search, _block(held, search.best.fit)),
        )  # fmt: skip
    if not search.best.keys:
        return _without_name(problem, search, held)
    return _with_name(problem, search, held)


def _share(problem: FitProblem, search: SearchResult) -> float:
    """Share of the gap that is explained; what chance may leave does not count as left."""
    chance = float(np.sqrt(2.0 * len(problem.rows)))
    return 1.0 - max(search.left - chance, 0.0) / max(search.gap, 1.0)


def _without_name(problem: FitProblem, search: SearchResult, held: dict[str, HeldOut]) -> Verdict:
    floor = _floor_source(problem)
    unseen = search.gap
    if floor == "replicates":
        # What replicates do not share is noise, whatever the model of the noise says of its size.
        unseen = min(unseen, max(shared_chi2(problem, problem.base.residual), 0.0))
    unseen /= max(len(problem.rows), 1)
    if floor is None:
        return _verdict(
            problem,
            search,
            held,
            "below_resolution",
            f"{problem.noise.freedom} replicates beyond the first: too few to tell a gap from "
            f"noise, {DECISION.needed_replicates} are needed",
            none=0.5,
            unknown=0.5,
        )
    if unseen > DECISION.unexplained_per_row:
        block = _block(held, problem.base)
        stage = _stage_of_block(problem, search, block)
        return _verdict(
            problem, search, held, "unknown",
            f"a gap that no entry of the catalogue explains, in the {block} residual",
            none=0.02, unknown=0.98, stage=stage,
        )  # fmt: skip
    far = _out_of_reach(problem, search)
    if far is not None:
        block = _block(held, problem.base)
        return _verdict(
            problem, search, held, "unknown",
            f"a gap that no entry of the catalogue explains: {far}", none=0.02, unknown=0.98,
            stage=_stage_of_block(problem, search, block),
        )  # fmt: skip
    apart = next((c for c in contrasts_of(problem) if c.alarm), None)
    if apart is not None:
        # Replicates far apart in time take a drift for noise; their order tells it.
        return _verdict(
            problem, search, held, "unknown",
            f"a gap that no entry of the catalogue explains: the contrast {apart.name} stands at "
            f"{apart.z:.1f} sd", none=0.02, unknown=0.98,
            stage=_stage_of_block(problem, search, _block(held, problem.base)),
        )  # fmt: skip
    best = max(search.first_gain.values(), default=0.0)
    unknown = 0.02 + 0.2 * min(unseen / DECISION.unexplained_per_row, 1.0) ** 2
    none = (1.0 - unknown) * (1.0 - 0.15 * min(best / SELECTION.least_gain, 1.0))
    return _verdict(
        problem, search, held, "no_gap_above_floor",
        "the plant, recalibrated within its tolerances, agrees with the data to within the floor",
        none=none, unknown=1.0 - none,
    )  # fmt: skip


def _out_of_reach(problem: FitProblem, search: SearchResult) -> str | None:
    """What shows a gap although no entry does: a constant at its wall, or what replicates share."""
    chance = float(np.sqrt(2.0 * len(problem.rows)))
    named = len(problem.names) - problem.unnamed
    shift = np.abs(problem.base.shift[:named])
    if (
        shift.max(initial=0.0) > DECISION.at_bound_sd
        and search.gap > DECISION.at_bound_chance * chance
    ):
        constant = problem.names[int(np.argmax(shift))]
        return f"{constant} is led beyond its tolerance, and more than chance is left"
    shared = shared_chi2(problem, problem.base.residual)
    if min(shared, search.gap) > DECISION.shared_chance * chance:
        return f"replicates share {shared / chance:.1f} sd more than chance"
    return None


def _defect(problem: FitProblem, search: SearchResult, held: dict[str, HeldOut]) -> Verdict:
    candidate = search.best.fit.candidates[0]
    amount = float(search.best.fit.amounts[0])
    more = f" by about {amount:.3g} ms" if candidate.id.endswith("clock") else ""
    return _verdict(
        problem, search, held, "data_unfit", DEFECTS[candidate.id] + more, none=0.0, unknown=1.0,
        evidence={"defect": candidate.id, "amount": amount},
    )  # fmt: skip


def _with_name(problem: FitProblem, search: SearchResult, held: dict[str, HeldOut]) -> Verdict:
    best = search.best
    block = _block(held, best.fit)
    gap = gap_of(block, held[block], True, _floor_source(problem), "slot")
    share = _share(problem, search)
    names = " and ".join(best.fit.ids)
    if _floor_source(problem) is None:
        return _verdict(
            problem,
            search,
            held,
            "below_resolution",
            f"the data look like {names}, but with {problem.noise.freedom} replicates beyond the "
            "first nothing can be told from noise",
            none=0.3,
            unknown=0.5,
            gap=gap,
        )
    traits = traits_of(problem, search, held)
    reliability = learnt().of(traits)
    none = min(search.chance, 0.5)
    weighted = posterior(search, reliability, none)
    one, two = _confounders(problem, search)
    confounding = [
        m
        for m in (one, two)
        if m and m.share >= DECISION.confounder_share and not _ruled_out(problem, search, m)
    ]
    evidence: dict[str, object] = {
        "share_explained": share,
        "belief": reliability,
        "mimics": [{"ids": m.ids, "share": m.share} for m in (one, two) if m],
        "steps": [{"entry": k, "gain": g} for k, g in search.steps],
        "further": [test.as_dict(included) for test, included in search.tests],
        "traits": traits,
    }
    if reliability["unknown"] > DECISION.unknown:
        return _verdict(
            problem,
            search,
            held,
            "unknown",
            f"a gap of which the best entry ({names}) explains {100 * share:.0f} %, in a way that "
            "points to something the catalogue does not hold",
            none=none,
            unknown=weighted.unknown,
            gap=gap,
            stage=_stage_of_block(problem, search, block),
            entries=weighted.entries,
            confounders=confounding,
            evidence=evidence,
        )
    drift = drifting(problem, best.fit)
    if drift is not None:
        return _verdict(
            problem,
            search,
            held,
            "unknown",
            f"a gap of which {names} explains a part and no drift over the trials: the contrast "
            f"{drift.name} still stands at {drift.z:.1f} sd",
            none=none,
            unknown=max(weighted.unknown, DECISION.drift_unknown),
            gap=gap,
            stage=_stage_of_block(problem, search, block),
            entries=weighted.entries,
            confounders=confounding,
            evidence=evidence,
        )
    entries = credible_set(weighted)
    ids = {frozenset(hypothesis.fit.ids) for hypothesis, _ in entries}
    status, reason = _status(
        search, gap, share, _nearest(search, problem.base.cost, one), two, len(ids), names
    )
    partly = reliability["right"] + reliability["part"]
    if len(best.fit.ids) > 1:
        sure = partly >= DECISION.named_several and reliability["right"] >= DECISION.named_all
    else:
        sure = partly >= DECISION.named
    if status in ("named", "named_form_inadequate") and not sure:
        status, reason = (
            "indistinguishable",
            f"{names} fits best, but an explanation that looks like this one is right in "
            f"{100 * reliability['right']:.0f} % of cases only",
        )
    return _verdict(
        problem,
        search,
        held,
        status,
        reason,
        none=weighted.none,
        unknown=weighted.unknown,
        gap=gap,
        stage=CATALOGUE[best.fit.ids[0]].stage,
        entries=entries,
        confounders=confounding,
        evidence=evidence,
    )


def _confounders(
    problem: FitProblem, search: SearchResult
) -> tuple[Confounder | None, Confounder | None]:
    """Best single and pair that could stand in for the explanation, by signatures.

    What leaves most of one effect's gap as it is takes its name away even where the data rule it
    out: told apart by a few per cent of the gap, the name would rest on the effect's exact form.
    """
    fit = search.best.fit
    one, two = ConfounderSearch(problem).of(
        problem.base.residual - fit.residual, frozenset(fit.ids)
    )
    if len(fit.ids) > 1:
        one, two = (None if m and _ruled_out(problem, search, m) else m for m in (one, two))
    return one, two


def _nearest(search: SearchResult, base: float, one: Confounder | None) -> Confounder | None:
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


def _ruled_out(problem: FitProblem, search: SearchResult, confounder: Confounder) -> bool:
    """Whether a confounder leaves more than noise and inexact forms could."""
    whole = max(problem.base.cost - search.best.cost, 0.0)
    bearable = max(DECISION.confounder_left, DECISION.confounder_left_factor * search.left)
    return (
        confounder.share < DECISION.confounder_sure and (1.0 - confounder.share) * whole >= bearable
    )


def _status(
    search: SearchResult,
    gap: Gap,
    share: float,
    one: Confounder | None,
    two: Confounder | None,
    rivals: int,
    names: str,
) -> tuple[str, str]:
    if rivals > 1 or (one is not None and one.share >= DECISION.confounder_share):
        other = (
            f"; {' + '.join(one.ids)} would look alike"
            if one and one.share >= DECISION.confounder_share
            else ""
        )
        return (
            "indistinguishable",
            f"{names} or another entry of the set: these data fit both{other}",
        )
    if two is not None and two.share >= DECISION.confounder_share:
        return "mimicable", f"{names}, or {' and '.join(two.ids)} acting together"
    if share < DECISION.form_share:
        return (
            "named_form_inadequate",
            f"{names} explains {100 * share:.0f} % of the gap; its form leaves a pattern",
        )
    if gap.closed_low is not None and gap.closed_low <= DECISION.closed_share:
        return (
            "named_form_inadequate",
            f"{names}; held out, the closed fraction is not certain to exceed one half",
        )
    return "named", f"{names} explains the gap"


def _verdict(
    problem: FitProblem,
    search: SearchResult,
    held: dict[str, HeldOut],
    status: str,
    reason: str,
    none: float,
    unknown: float,
    gap: Gap | None = None,
    stage: str | None = None,
    entries: list[tuple[Hypothesis, float]] | None = None,
    confounders: list[Confounder] | None = None,
    evidence: dict[str, object] | None = None,
) -> Verdict:
    if gap is None and held:
        block = _block(held, search.best.fit)
        gap = gap_of(block, held[block], False, _floor_source(problem), "slot")
    effects = _explanations(problem, entries or [], confounders or [], none, unknown)
    whole = none + unknown + sum(effect.probability for effect in effects)
    scale = 1.0 / whole if whole > 0.0 else 1.0
    return Verdict(
        status=status,
        reason=reason,
        stage="muscle" if stage == "any" else stage,  # wear: the pull is where it shows
        effects=tuple(
            Explanation(e.ids, e.family, e.probability * scale, e.parameters) for e in effects
        ),
        probability_none=none * scale,
        probability_unknown=unknown * scale,
        gap=gap,
        stages=stage_shares(problem, search.best.fit, held) if held else (),
        contrasts=contrasts_of(problem),
        limits=detection_limits(problem, SELECTION.least_gain),
        next_experiment=advise(
            problem, _leader(entries), _others(problem, search, entries, confounders)
        ),
        why_not=why_not(problem, search, {i for e in effects for i in e.ids}),
        notes=problem.data.notes,
        evidence={
            "found": list(search.best.fit.ids),
            **(evidence or {}),
        },
    )


def _leader(entries: list[tuple[Hypothesis, float]] | None) -> FitResult | None:
    return entries[0][0].fit if entries else None


def _others(
    problem: FitProblem,
    search: SearchResult,
    entries: list[tuple[Hypothesis, float]] | None,
    confounders: list[Confounder] | None,
) -> list[FitResult]:
    """Fits that an experiment should tell from the best one."""
    if not entries:
        return []
    others = [hypothesis.fit for hypothesis, _ in entries[1:]]
    for confounder in confounders or []:
        candidates = [
            next(s for s in problem.candidates if s.id == name) for name in confounder.ids
        ]
        others.append(problem.fit(candidates, [s.step for s in candidates]))
    return others or [c.fit for c in search.rivals[:1]]


def _explanations(
    problem: FitProblem,
    entries: list[tuple[Hypothesis, float]],
    confounders: list[Confounder],
    none: float,
    unknown: float,
) -> list[Explanation]:
    made: dict[frozenset[str], Explanation] = {}
    for hypothesis, p in entries:
        ids = hypothesis.fit.ids
        key = frozenset(ids)
        if key in made:
            kept = made[key]
            made[key] = Explanation(kept.ids, kept.family, kept.probability + p, kept.parameters)
            continue
        families = dict.fromkeys(CATALOGUE[name].family for name in ids)
        made[key] = Explanation(
            ids, "+".join(families), p, headline_estimates(problem, hypothesis.fit, learnt().form)
        )
    # What confounders the best entry shares its credit: on these data nothing tells them apart.
    for confounder in confounders:
        key = frozenset(confounder.ids)
        if key not in made and made:
            first = next(iter(made.values()))
            families = dict.fromkeys(CATALOGUE[name].family for name in confounder.ids)
            made[key] = Explanation(
                confounder.ids,
                "+".join(families),
                DECISION.confounder_weight * first.probability,
                {},
            )
    return sorted(made.values(), key=lambda e: -e.probability)


def _floor_source(problem: FitProblem) -> str | None:
    if problem.noise.pairs and problem.noise.freedom >= DECISION.needed_replicates:
        return "replicates"
    return "smoothness" if problem.data.settled else None


def _block(held: dict[str, HeldOut], fit: FitResult) -> str:
    """The block whose gap stands highest above its floor, or is closed most."""

    def height(block: str) -> float:
        part = held[block]
        floor = max(part.rms("floor"), 1e-6) ** 2
        gained = part.rms("recalibrated") ** 2 - (
            part.rms("after") ** 2 if fit.candidates else part.rms("floor") ** 2
        )
        sure = not fit.candidates or part.closed() is not None
        return gained / floor * (0.2 if block == "camera" else 1.0) * (1.0 if sure else 0.1)

    return max(held, key=height)


def _stage_of_block(problem: FitProblem, search: SearchResult, block: str) -> str | None:
    """Stage of the candidate that comes nearest among those that touch the block."""
    known = {s.key: s for s in problem.candidates if not s.defect and block in s.blocks}
    gains = {k: g for k, g in search.first_gain.items() if k in known}
    if not gains:
        return None
    stage = CATALOGUE[known[max(gains, key=lambda k: gains[k])].id].stage
    return None if stage == "any" else stage
