"""A verdict, or the conclusion from several tests, in sentences: one first, then the reasons."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass

from gap.decision.sequential import NAMED, SequentialVerdict
from gap.design.config import DESIGN
from gap.reason import PARTS, Cause
from gap.verdict import Estimate, Experiment, Status, Verdict
from plant.effects.catalogue import CATALOGUE

HEADS = {
    "named": "Found",
    "named_form_inadequate": "Found, but not in full",
    "indistinguishable": "One of several",
    "mimicable": "One, or others acting together",
    "unknown": "A gap whose cause is not known",
    "no_gap_above_floor": "No gap above the floor",
    "below_resolution": "Too few replicates to say",
    "data_unfit": "The data are not fit to be diagnosed",
    "nominal_unfit": "The nominal plant is not that of these data",
}
CAREFUL = (
    "These data are consistent with it; that it is the cause is shown by taking it away, or by the "
    "reference named below."
)
BY_STANDARD = (
    "A reference standard showed it by itself; it is stated, and no part of the gap any more."
)


@dataclass(frozen=True)
class Rival:
    """An entry that was not chosen, and why not."""

    id: str
    why: str


def headline(verdict: Verdict) -> str:
    """The verdict in one sentence."""
    if not verdict.effects or not verdict.status.explained:
        return sentence(str(verdict.reason))
    best = verdict.effects[0]
    what = " and ".join(f"{name} ({CATALOGUE[name].summary})" for name in best.ids)
    values = ", ".join(parameter_text(name, e) for name, e in best.parameters.items())
    closed = _closed(verdict)
    match verdict.status:
        case "named" if verdict.reason.cause is Cause.BY_TRIAL:
            return sentence(str(verdict.reason))
        case "named":
            return sentence(f"It is {what}{_in_brackets(values)}{closed}")
        case "named_form_inadequate" if verdict.reason.cause is Cause.PARTLY_OPEN:
            return sentence(str(verdict.reason))
        case "named_form_inadequate" if verdict.reason.cause in PARTS:
            percent = verdict.reason.values["percent"]
            assert isinstance(percent, float)
            share = f", {percent:.0f} % sure{closed}"
            return sentence(
                f"{what}{_in_brackets(values)} act{'s' if len(best.ids) == 1 else ''}, whatever "
                f"else does{share}; {verdict.reason.values['rest']} is not known"
            )
        case "named_form_inadequate":
            return sentence(
                f"It is {what}{_in_brackets(values)}{closed}; "
                "the form in the catalogue leaves a pattern"
            )
    others = ", ".join(" + ".join(effect.ids) for effect in verdict.effects[1:4])
    if not others:
        return sentence(str(verdict.reason))
    sure = f"{' and '.join(verdict.sure)} in any case; " if verdict.sure else ""
    return sentence(f"{sure}{what}, or {others}: these data fit all of them")


def _closed(verdict: Verdict) -> str:
    gap = verdict.headline_gap
    if gap is None or gap.closed is None:
        return ""
    interval = ""
    if gap.closed_low is not None and gap.closed_high is not None:
        low, high = (f"{100 * min(x, 1.0):.0f}" for x in (gap.closed_low, gap.closed_high))
        interval = f" ({low} to {high} %)" if low != high else ""
    return (
        f" and closes {100 * min(gap.closed, 1.0):.0f} %{interval} of the gap above the floor, "
        + (
            f"on data held out by {gap.held_out}"
            if gap.held_out
            else "on the data that it was fitted to"
        )
    )


def _in_brackets(values: str) -> str:
    return f", {values}," if values else ""


def sentence(text: str) -> str:
    """Text with a full stop, and a capital unless it begins with the name of an entry."""
    text = text.strip().rstrip(".,").replace(",; ", "; ")
    first = re.match(r"\w*", text)
    if first is not None and first[0] in CATALOGUE:
        return text + "."
    return text[:1].upper() + text[1:] + "."


def parameter_text(name: str, estimate: Estimate) -> str:
    """A parameter as text: threshold 33 kPa (29.2 to 36.7)."""
    units = {p.name: p.unit for entry in CATALOGUE.values() for p in entry.parameters}
    growths = (entry.search.growth for entry in CATALOGUE.values())
    units |= {growth.name: growth.unit for growth in growths if growth is not None}
    base = next((known for known in units if name == known or name.endswith(f"_{known}")), name)
    unit = units.get(base, "")
    tail = "_" + re.sub(r"[^a-z0-9]+", "_", unit.lower()).strip("_")
    text = base.removesuffix(tail) if unit else base
    if text.startswith("percent"):
        text = ""  # the unit says so
    value = (
        estimate.value
        if isinstance(estimate.value, str)
        else f"{estimate.value:.3g} {unit}".strip()
    )
    if estimate.low is not None and estimate.high is not None:
        value += f" ({estimate.low:.3g} to {estimate.high:.3g})"
    return f"{text.replace('_', ' ')} {value}".strip()


def gap_sentences(verdict: Verdict) -> list[str]:
    """How large the gap was and what became of it."""
    gap = verdict.headline_gap
    if gap is None:
        return []
    text = [
        f"As stated, the plant is off by {gap.before:.3g} {gap.unit}; recalibrated within the "
        f"tolerances of its constants by {gap.recalibrated:.3g} {gap.unit}."
    ]
    if gap.after is not None and verdict.effects and verdict.status.explained:
        text.append(f"With what was found {gap.after:.3g} {gap.unit} remain.")
        if gap.held_out is not None and gap.after > gap.recalibrated:
            text.append(
                f"Each {gap.held_out} was left out in turn: what one {gap.held_out} alone shows "
                "cannot be learnt from the others."
            )
    if gap.floor is not None:
        source = {
            "replicates": "replicates of the same setting differ by",
            "stated": "the stated noise is",
            "smoothness": "neighbouring points differ from a smooth course by",
        }.get(gap.floor_source or "", "the floor is")
        text.append(
            f"No model could do better than the floor: {source} {gap.floor:.3g} {gap.unit}."
        )
    return text


def told_apart(verdict: Verdict) -> list[tuple[str, str]]:
    """For each entry of the set, what experiment or reference would settle it.

    What a reference standard has shown is settled.
    """
    names = dict.fromkeys(name for effect in verdict.effects for name in effect.ids)
    return [(n, CATALOGUE[n].told_apart_by) for n in names if n not in shown_by_standards(verdict)]


def shown_by_standards(verdict: Verdict) -> frozenset[str]:
    """Ids of the errors that reference standards have shown."""
    return frozenset(verdict.evidence.get("standards", {}).get("shown", ()))


def careful(verdict: Verdict) -> str:
    """What an explanation rests on; empty where the verdict stands by none."""
    if not verdict.effects or not verdict.status.explained:
        return ""
    shown = shown_by_standards(verdict)
    return BY_STANDARD if shown and shown >= set(verdict.effects[0].ids) else CAREFUL


_WORTH_IT = 1.01
"""Separation after an experiment over that before it, from which there is a reason to make it."""


def experiment_sentence(experiment: Experiment, named: bool = True) -> str:
    """The next experiment, with the separation it promises.

    `named`: one explanation was named, so that an experiment can only make it surer.
    """
    if not experiment.trials:
        return sentence(experiment.protocol)
    settings = ", ".join(_setting(k, v) for k, v in experiment.settings.items())
    between = f" between {' and '.join(experiment.between)}" if experiment.between else ""
    what = experiment.protocol + (f" ({settings})" if settings else "")
    count = f"{experiment.trials} trial{'s' if experiment.trials != 1 else ''} of {what}"
    already = (
        "These data tell them apart already, as far as the forms of the catalogue go. To be more"
        " certain: "
        if named and experiment.separation_now >= DESIGN.enough_sd
        else ""
    )
    if not math.isfinite(experiment.separation_after):
        return sentence(count)
    if experiment.separation_after < _WORTH_IT * experiment.separation_now:
        return sentence(
            f"No test of the library adds to the separation{between}, now "
            f"{experiment.separation_now:.1f} standard deviations as far as the forms of the "
            "catalogue go: see below what tells them apart by itself"
        )
    promised = sentence(
        f"{count}: the separation{between} would rise from {experiment.separation_now:.1f} to "
        f"{experiment.separation_after:.1f} standard deviations ({DESIGN.enough_sd:g} are right 95 "
        "times in 100, as far as the forms of the catalogue go)"
    )
    barely = barely_enough(experiment)
    return already + promised + (f" {sentence(barely)}" if barely else "")


def barely_enough(experiment: Experiment) -> str | None:
    """What to say where forms that are not exact may take the promised separation away, or None.

    A reference standard measures one effect by itself, whatever the forms of the others.
    """
    if experiment.protocol == "reference" or not experiment.separation_after < DESIGN.kept_sd:
        return None
    return (
        "barely enough: where the true form differs from that of the catalogue it may come out "
        "otherwise, and repeats do not help against that"
    )


UNITS = ("kpa", "mm_s", "mm", "kg", "s", "c")
UNIT_TEXT = {"kpa": "kPa", "mm_s": "mm/s", "c": "°C"}


def _setting(key: str, value: object) -> str:
    """A setting of a protocol as text: pressures 80, 150 kPa."""
    unit = next((u for u in UNITS if key.endswith(f"_{u}")), "")
    name = key.removesuffix(f"_{unit}") if unit else key
    if isinstance(value, Mapping):
        return f"{name} ({', '.join(_setting(k, v) for k, v in value.items())})"
    if value is None:
        return f"without {name.replace('_', ' ')}"
    many = value if isinstance(value, (list, tuple)) else [value]
    text = ", ".join(f"{one:g}" if isinstance(one, float) else str(one) for one in many)
    return f"{name.replace('_', ' ')} {text} {UNIT_TEXT.get(unit, unit)}".strip()


def rivals(verdict: Verdict) -> list[Rival]:
    """Entries that were not chosen, those that came nearest first."""
    named = {name for effect in verdict.effects for name in effect.ids}
    found = [(-why.rank, name, why) for name, why in verdict.why_not.items() if name not in named]
    return [Rival(name, str(why)) for _, name, why in sorted(found, key=lambda one: one[:2])]


def limits(verdict: Verdict) -> list[tuple[str, str]]:
    """Smallest headline parameter of each effect that these data would have shown."""
    rows = []
    for name, value in sorted(verdict.limits.items()):
        entry = CATALOGUE.get(name)
        if entry is not None:
            unit = f" {entry.unit}" if entry.unit else ""
            rows.append((name, f"{(entry.headline or '').replace('_', ' ')}: {value:.3g}{unit}"))
    return rows


def conclusion_text(found: SequentialVerdict) -> str:
    """Return the reason for `found.conclusion` as one sentence."""
    assert found.verdict is not None
    if found.verdict.status == Status.NO_GAP_ABOVE_FLOOR and found.relieving:
        return sentence(
            "simulation and measurement agree to within the floor only with a stated constant at "
            "the end of its tolerance; "
            f"{' or '.join(found.relieving)} in its place would fit as well"
        )
    if found.by_standard:
        return headline(found.verdict)
    if found.verdict.status in NAMED and found.cut_short:
        names = " and ".join(found.verdict.effects[0].ids)
        return sentence(
            f"{names} together fit the tests that were made, but no test has needed each of them, "
            "and a fault ended the investigation"
        )
    if found.confirmed is None:
        apart = found.apart_by_reference
        others = [name for name in apart if name not in found.verdict.effects[0].ids]
        said = headline(found.verdict)
        if not others:
            return said
        return f"{said} It takes a reference to tell it from {' or '.join(others)}."
    protocol, prediction = found.confirmed
    ids = [" + ".join(effect.ids) for effect in found.of_family]
    return sentence(
        f"It is {' or '.join(ids)}, found on the tests before and confirmed by the {protocol} "
        f"test: it predicted {100 * prediction.share:.0f} % of the gap there, and no other "
        "explanation predicted as much"
    )
