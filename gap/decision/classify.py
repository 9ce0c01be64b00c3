"""The verdict on what a search found: named, one of several, a mimic, unknown, or nothing there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gap.decision.confounders import Mimic, Mimicry
from gap.decision.posterior import ambiguity_set, weigh
from gap.decision.reliability import learnt
from gap.decision.traits import traits_of
from gap.design.advise import advise
from gap.effects.candidates import DEFECTS
from gap.estimation.agreement import repeated
from gap.estimation.fit_problem import Inquiry, State
from gap.estimation.intervals import headline_estimates, limits_of
from gap.selection.forward import ALARM, Naming, why_not
from gap.selection.inclusion import AT_THE_END
from gap.selection.per_stroke import eased
from gap.selection.pruning import Cleared, cleared
from gap.selection.refine import Choice
from gap.validation.shrink import Held, gap_of, held_out
from gap.validation.where import contrasts_of, drifting, stage_shares
from gap.verdict import Explanation, Gap, Verdict
from plant.effects.catalogue import CATALOGUE

MIMIC = 0.9
SURE = 0.985
TOLD_APART = 120.0
"""Whitened sum of squares that a mimic may leave more than the named effect does."""
NAMED = 0.72
"""Least belief that a name is not wrong (all of it hidden, or part) for it to be given."""
NAMED_SEVERAL = 0.58
"""The same for several effects: where one of them is wrong, the other seldom is."""
NAMED_ALL = 0.34
"""For several effects: least belief in all of them."""
UNKNOWN = 0.45
"""Belief in something outside the catalogue from which the verdict says so."""
HALF = 0.5
FORM_FULL = 0.9
UNSEEN = 0.2
STANDS_OUT = 3.0
"""Sd of chance by which the gap stands out where a constant is led to the end of its tolerance."""
SHARED = 4.0
"""Sd of chance of what is left, and of what replicates share of it, that are no chance."""
DRIFTS = 0.5
"""Least probability of something unknown where a drift over the trials is left."""
NEEDED_REPLICATES = 3


def judge(q: Inquiry, naming: Naming) -> tuple[Verdict, Naming]:
    """Turn the outcome of a search into a verdict, and say which explanation it rests on."""
    outcome = cleared(q, naming)
    outcome = replace(outcome, naming=eased(q, outcome.naming))
    return _judged(q, outcome), outcome.naming


def _judged(q: Inquiry, outcome: Cleared) -> Verdict:
    naming = outcome.naming
    held = held_out(q, naming.chosen.state)
    if outcome.defect:
        return _defect(q, naming, held)
    if outcome.blurred:
        return _verdict(
            q, naming, held, "unknown",
            "a gap that a fault of the recording would explain better than any effect, but the "
            "trials do not agree on the fault", none=0.0, unknown=1.0,
            stage=_stage_of_block(q, naming, _block(held, naming.chosen.state)),
        )  # fmt: skip
    if not naming.chosen.keys:
        return _without_name(q, naming, held)
    return _with_name(q, naming, held)


def _share(q: Inquiry, naming: Naming) -> float:
    """Share of the gap that is explained; what chance may leave does not count as left."""
    chance = float(np.sqrt(2.0 * len(q.rows)))
    return 1.0 - max(naming.left - chance, 0.0) / max(naming.excess, 1.0)


def _without_name(q: Inquiry, naming: Naming, held: dict[str, Held]) -> Verdict:
    floor = _floor_source(q)
    unseen = naming.excess
    if floor == "replicates":
        # What replicates do not share is noise, whatever the model of the noise says of its size.
        unseen = min(unseen, max(repeated(q, q.base.residual), 0.0))
    unseen /= max(len(q.rows), 1)
    if floor is None:
        return _verdict(
            q, naming, held, "below_resolution",
            f"{q.noise.freedom} replicates beyond the first: too few to tell a gap from noise, "
            f"{NEEDED_REPLICATES} are needed", none=0.5, unknown=0.5,
        )  # fmt: skip
    if unseen > UNSEEN:
        block = _block(held, q.base)
        stage = _stage_of_block(q, naming, block)
        return _verdict(
            q, naming, held, "unknown",
            f"a gap that no entry of the catalogue explains, in the {block} residual",
            none=0.02, unknown=0.98, stage=stage,
        )  # fmt: skip
    far = _out_of_reach(q, naming)
    if far is not None:
        block = _block(held, q.base)
        return _verdict(
            q, naming, held, "unknown",
            f"a gap that no entry of the catalogue explains: {far}", none=0.02, unknown=0.98,
            stage=_stage_of_block(q, naming, block),
        )  # fmt: skip
    apart = next((c for c in contrasts_of(q) if c.alarm), None)
    if apart is not None:
        # Replicates far apart in time take a drift for noise; their order tells it.
        return _verdict(
            q, naming, held, "unknown",
            f"a gap that no entry of the catalogue explains: the contrast {apart.name} stands at "
            f"{apart.z:.1f} sd", none=0.02, unknown=0.98,
            stage=_stage_of_block(q, naming, _block(held, q.base)),
        )  # fmt: skip
    best = max(naming.first_gain.values(), default=0.0)
    unknown = 0.02 + 0.2 * min(unseen / UNSEEN, 1.0) ** 2
    none = (1.0 - unknown) * (1.0 - 0.15 * min(best / ALARM, 1.0))
    return _verdict(
        q, naming, held, "no_gap_above_floor",
        "the plant, recalibrated within its tolerances, agrees with the data to within the floor",
        none=none, unknown=1.0 - none,
    )  # fmt: skip


def _out_of_reach(q: Inquiry, naming: Naming) -> str | None:
    """What shows a gap although no entry does: a constant at its wall, or what replicates share."""
    chance = float(np.sqrt(2.0 * len(q.rows)))
    named = len(q.names) - q.unnamed
    shift = np.abs(q.base.shift[:named])
    if shift.max(initial=0.0) > AT_THE_END and naming.excess > STANDS_OUT * chance:
        constant = q.names[int(np.argmax(shift))]
        return f"{constant} is led beyond its tolerance, and more than chance is left"
    shared = repeated(q, q.base.residual)
    if min(shared, naming.excess) > SHARED * chance:
        return f"replicates share {shared / chance:.1f} sd more than chance"
    return None


def _defect(q: Inquiry, naming: Naming, held: dict[str, Held]) -> Verdict:
    suspect = naming.chosen.state.suspects[0]
    amount = float(naming.chosen.state.amounts[0])
    more = f" by about {amount:.3g} ms" if suspect.id.endswith("clock") else ""
    return _verdict(
        q, naming, held, "data_unfit", DEFECTS[suspect.id] + more, none=0.0, unknown=1.0,
        evidence={"defect": suspect.id, "amount": amount},
    )  # fmt: skip


def _with_name(q: Inquiry, naming: Naming, held: dict[str, Held]) -> Verdict:
    chosen = naming.chosen
    block = _block(held, chosen.state)
    gap = gap_of(block, held[block], True, _floor_source(q), "slot")
    share = _share(q, naming)
    names = " and ".join(chosen.state.ids)
    if _floor_source(q) is None:
        return _verdict(
            q, naming, held, "below_resolution",
            f"the data look like {names}, but with {q.noise.freedom} replicates beyond the first "
            "nothing can be told from noise", none=0.3, unknown=0.5, gap=gap,
        )  # fmt: skip
    traits = traits_of(q, naming, held)
    belief = learnt().of(traits)
    none = min(naming.chance, 0.5)
    weighed = weigh(naming, belief, none)
    one, two = _mimics(q, naming)
    extra = [m for m in (one, two) if m and m.share >= MIMIC and not _ruled_out(q, naming, m)]
    evidence: dict[str, object] = {
        "share_explained": share,
        "belief": belief,
        "mimics": [{"ids": m.ids, "share": m.share} for m in (one, two) if m],
        "steps": [{"entry": k, "gain": g} for k, g in naming.steps],
        "further": naming.tried,
        "traits": traits,
    }
    if belief["unknown"] > UNKNOWN:
        return _verdict(
            q, naming, held, "unknown",
            f"a gap of which the best entry ({names}) explains {100 * share:.0f} %, in a way that "
            "points to something the catalogue does not hold",
            none=none, unknown=weighed.unknown, gap=gap, stage=_stage_of_block(q, naming, block),
            entries=weighed.entries, mimics=extra, evidence=evidence,
        )  # fmt: skip
    drift = drifting(q, chosen.state)
    if drift is not None:
        return _verdict(
            q, naming, held, "unknown",
            f"a gap of which {names} explains a part and no drift over the trials: the contrast "
            f"{drift.name} still stands at {drift.z:.1f} sd",
            none=none, unknown=max(weighed.unknown, DRIFTS), gap=gap,
            stage=_stage_of_block(q, naming, block), entries=weighed.entries, mimics=extra,
            evidence=evidence,
        )  # fmt: skip
    entries = ambiguity_set(weighed)
    ids = {frozenset(choice.state.ids) for choice, _ in entries}
    status, reason = _status(
        naming, gap, share, _nearest(naming, q.base.cost, one), two, len(ids), names
    )
    partly = belief["right"] + belief["part"]
    if len(chosen.state.ids) > 1:
        sure = partly >= NAMED_SEVERAL and belief["right"] >= NAMED_ALL
    else:
        sure = partly >= NAMED
    if status in ("named", "named_form_inadequate") and not sure:
        status, reason = (
            "indistinguishable",
            f"{names} fits best, but an explanation that looks like this one is right in "
            f"{100 * belief['right']:.0f} % of cases only",
        )
    return _verdict(
        q, naming, held, status, reason, none=weighed.none, unknown=weighed.unknown, gap=gap,
        stage=CATALOGUE[chosen.state.ids[0]].stage, entries=entries, mimics=extra,
        evidence=evidence,
    )  # fmt: skip


def _mimics(q: Inquiry, naming: Naming) -> tuple[Mimic | None, Mimic | None]:
    """Best single and pair that could stand in for the explanation, by signatures.

    What leaves most of one effect's gap as it is takes its name away even where the data rule it
    out: told apart by a few per cent of the gap, the name would rest on the effect's exact form.
    """
    state = naming.chosen.state
    one, two = Mimicry(q).of(q.base.residual - state.residual, frozenset(state.ids))
    if len(state.ids) > 1:
        one, two = (None if m and _ruled_out(q, naming, m) else m for m in (one, two))
    return one, two


def _nearest(naming: Naming, base: float, one: Mimic | None) -> Mimic | None:
    """The mimic `one`, or the rival of the search that takes more at the size that it needs.

    `base` is the cost of the plant without any effect.
    """
    state = naming.chosen.state
    whole = max(base - state.cost, 1e-9)
    for rival in naming.rivals if len(state.ids) == 1 else []:
        taken = 1.0 - (rival.cost - state.cost) / whole
        if rival.state.ids != state.ids and (one is None or taken > one.share):
            one = Mimic(rival.state.ids, min(taken, 1.0))
    return one


def _ruled_out(q: Inquiry, naming: Naming, mimic: Mimic) -> bool:
    """Whether a mimic leaves more than noise and inexact forms could."""
    whole = max(q.base.cost - naming.chosen.cost, 0.0)
    bearable = max(TOLD_APART, 3.0 * naming.left)
    return mimic.share < SURE and (1.0 - mimic.share) * whole >= bearable


def _status(
    naming: Naming, gap: Gap, share: float, one: Mimic | None, two: Mimic | None, rivals: int,
    names: str,
) -> tuple[str, str]:  # fmt: skip
    if rivals > 1 or (one is not None and one.share >= MIMIC):
        other = f"; {' + '.join(one.ids)} would look alike" if one and one.share >= MIMIC else ""
        return (
            "indistinguishable",
            f"{names} or another entry of the set: these data fit both{other}",
        )
    if two is not None and two.share >= MIMIC:
        return "mimicable", f"{names}, or {' and '.join(two.ids)} acting together"
    if share < FORM_FULL:
        return (
            "named_form_inadequate",
            f"{names} explains {100 * share:.0f} % of the gap; its form leaves a pattern",
        )
    if gap.closed_low is not None and gap.closed_low <= HALF:
        return (
            "named_form_inadequate",
            f"{names}; held out, the closed fraction is not certain to exceed one half",
        )
    return "named", f"{names} explains the gap"


def _verdict(  # noqa: PLR0913 - to be grouped with the verdict's parts
    q: Inquiry,
    naming: Naming,
    held: dict[str, Held],
    status: str,
    reason: str,
    none: float,
    unknown: float,
    gap: Gap | None = None,
    stage: str | None = None,
    entries: list[tuple[Choice, float]] | None = None,
    mimics: list[Mimic] | None = None,
    evidence: dict[str, object] | None = None,
) -> Verdict:
    if gap is None and held:
        block = _block(held, naming.chosen.state)
        gap = gap_of(block, held[block], False, _floor_source(q), "slot")
    effects = _explanations(q, entries or [], mimics or [], none, unknown)
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
        stages=stage_shares(q, naming.chosen.state, held) if held else (),
        contrasts=contrasts_of(q),
        limits=limits_of(q, ALARM),
        next_experiment=advise(q, _leader(entries), _others(q, naming, entries, mimics)),
        why_not=why_not(q, naming, {i for e in effects for i in e.ids}),
        notes=q.data.notes,
        evidence={
            "found": list(naming.chosen.state.ids),
            **(evidence or {}),
        },
    )


def _leader(entries: list[tuple[Choice, float]] | None) -> State | None:
    return entries[0][0].state if entries else None


def _others(
    q: Inquiry,
    naming: Naming,
    entries: list[tuple[Choice, float]] | None,
    mimics: list[Mimic] | None,
) -> list[State]:
    """Rivals an experiment should tell from the best: the set, its mimics, or the runner-up."""
    if not entries:
        return []
    others = [choice.state for choice, _ in entries[1:]]
    for mimic in mimics or []:
        suspects = [next(s for s in q.suspects if s.id == name) for name in mimic.ids]
        others.append(q.fit(suspects, [s.step for s in suspects]))
    return others or [c.state for c in naming.rivals[:1]]


def _explanations(
    q: Inquiry, entries: list[tuple[Choice, float]], mimics: list[Mimic], none: float,
    unknown: float,
) -> list[Explanation]:  # fmt: skip
    made: dict[frozenset[str], Explanation] = {}
    for choice, p in entries:
        ids = choice.state.ids
        key = frozenset(ids)
        if key in made:
            kept = made[key]
            made[key] = Explanation(kept.ids, kept.family, kept.probability + p, kept.parameters)
            continue
        families = dict.fromkeys(CATALOGUE[name].family for name in ids)
        made[key] = Explanation(ids, "+".join(families), p, headline_estimates(q, choice.state))
    # What mimics the best entry shares its credit: on these data nothing tells them apart.
    for mimic in mimics:
        key = frozenset(mimic.ids)
        if key not in made and made:
            first = next(iter(made.values()))
            families = dict.fromkeys(CATALOGUE[name].family for name in mimic.ids)
            made[key] = Explanation(mimic.ids, "+".join(families), 0.4 * first.probability, {})
    return sorted(made.values(), key=lambda e: -e.probability)


def _floor_source(q: Inquiry) -> str | None:
    if q.noise.pairs and q.noise.freedom >= NEEDED_REPLICATES:
        return "replicates"
    return "smoothness" if q.data.settled else None


def _block(held: dict[str, Held], state: State) -> str:
    """The block whose gap stands highest above its floor, or is closed most."""

    def height(block: str) -> float:
        part = held[block]
        floor = max(part.rms("floor"), 1e-6) ** 2
        gained = part.rms("recalibrated") ** 2 - (
            part.rms("after") ** 2 if state.suspects else part.rms("floor") ** 2
        )
        sure = not state.suspects or part.closed() is not None
        return gained / floor * (0.2 if block == "camera" else 1.0) * (1.0 if sure else 0.1)

    return max(held, key=height)


def _stage_of_block(q: Inquiry, naming: Naming, block: str) -> str | None:
    """Stage of the suspect that comes nearest among those that touch the block."""
    known = {s.key: s for s in q.suspects if not s.defect and block in s.blocks}
    gains = {k: g for k, g in naming.first_gain.items() if k in known}
    if not gains:
        return None
    stage = CATALOGUE[known[max(gains, key=lambda k: gains[k])].id].stage
    return None if stage == "any" else stage
