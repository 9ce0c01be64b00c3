"""What a verdict says of effects that differ between replicates."""

from __future__ import annotations

from dataclasses import replace

from gap.estimation.fit_problem import FitProblem
from gap.reason import Cause, reason
from gap.verdict import Estimate, Explanation, Status, Verdict
from plant.effects.catalogue import CATALOGUE

_SHOWN = 6


def with_effects_by_trial(verdict: Verdict, problem: FitProblem) -> Verdict:
    """The verdict with a note for each effect of which some trials have more than their replicates.

    Where nothing else is a gap, such an effect is what the data show.
    """
    amounts: dict[str, dict[str, float]] = {}
    for name, _, amount, shape in problem.by_trial:
        trial = problem.data.trials[int(shape["trial"])].name
        amounts.setdefault(name, {})[trial] = amount
    if not amounts:
        return verdict
    notes = tuple(_note(name, own) for name, own in amounts.items())
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


def _note(name: str, amounts: dict[str, float]) -> str:
    """One line with the trials, those with most first."""
    effect = CATALOGUE[name]
    unit = next((p.unit for p in effect.parameters if p.name == effect.headline), "")
    most = sorted(amounts, key=lambda trial: -amounts[trial])
    told = ", ".join(f"{trial} {amounts[trial]:.2g}" for trial in most[:_SHOWN])
    more = f" and {len(most) - _SHOWN} more" if len(most) > _SHOWN else ""
    return (
        f"{name} differs between replicates: beyond the one that has least, {told}{more} {unit}; "
        "the fit gives each its own"
    )
