"""The verdict of a diagnosis, and its JSON form."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from gap.reason import Reason
from plant.arrays import Array
from plant.effects.empirical import Correction


class Status(StrEnum):
    """What a diagnosis comes to."""

    NAMED = "named"
    NAMED_FORM_INADEQUATE = "named_form_inadequate"
    INDISTINGUISHABLE = "indistinguishable"
    MIMICABLE = "mimicable"
    UNKNOWN = "unknown"
    NO_GAP_ABOVE_FLOOR = "no_gap_above_floor"
    BELOW_RESOLUTION = "below_resolution"
    DATA_UNFIT = "data_unfit"
    NOMINAL_UNFIT = "nominal_unfit"

    @property
    def explained(self) -> bool:
        """Whether the verdict stands by the entries that it offers."""
        return self in _EXPLAINED


_EXPLAINED = frozenset(
    (
        Status.NAMED, Status.NAMED_FORM_INADEQUATE, Status.INDISTINGUISHABLE, Status.MIMICABLE,
    )
)  # fmt: skip


@dataclass(frozen=True)
class Estimate:
    """A parameter with its 95 % interval; `value` may be a word (a side, an edge)."""

    value: float | str
    low: float | None = None
    high: float | None = None


@dataclass(frozen=True)
class Explanation:
    """One entry of the ambiguity set: effects that together explain the gap.

    Attributes:
        ids: names of the effects.
        family: of the catalogue.
        probability: of this entry.
        parameters: by name, with 95 % intervals, in the units of the names.
    """

    ids: tuple[str, ...]
    family: str
    probability: float
    parameters: Mapping[str, Estimate] = field(default_factory=dict)


@dataclass(frozen=True)
class Gap:
    """How large the gap is, in `unit`, and how much of it is closed.

    `closed` = (recalibrated² - after²) / (recalibrated² - floor²), on held-out data.

    Attributes:
        unit: of the channel.
        before, recalibrated, after: rms difference of simulation and measurement with nominal
            constants, with fitted constants, and with the effects found.
        floor: rms difference that noise alone makes.
        floor_source: "replicates", "stated" or "smoothness"; None where there is no floor.
        closed, closed_low, closed_high: share that is closed, with its 95 % interval.
        held_out: what was left out for it, such as "slot"; None for nothing.
    """

    unit: str
    before: float
    recalibrated: float
    after: float | None
    floor: float | None
    floor_source: str | None
    closed: float | None = None
    closed_low: float | None = None
    closed_high: float | None = None
    held_out: str | None = None


@dataclass(frozen=True)
class Share:
    """A stage's share of the gap, with its interval."""

    stage: str
    share: float
    low: float
    high: float


@dataclass(frozen=True)
class Contrast:
    """One designed comparison of residuals, as a z-score.

    `alarm` is set after family-wise control; `drift` marks a change over the order of trials.
    """

    name: str
    z: float
    alarm: bool = False
    drift: bool = False


@dataclass(frozen=True)
class Experiment:
    """What to measure next, or which reference standard to bring."""

    protocol: str
    settings: Mapping[str, Any]
    separation_now: float
    separation_after: float
    trials: int
    between: tuple[str, ...] = ()
    why: str = ""


class Rejection(StrEnum):
    """Why an entry of the catalogue is not in the set."""

    NO_CHANNEL = "no_channel"
    WORSE_FIT = "worse_fit"
    SMALL_SHARE = "small_share"
    SMALL_GAIN = "small_gain"
    CLEARED = "cleared"


@dataclass(frozen=True)
class WhyNot:
    """Why an entry is not in the set, with the number that decides: chi-square or a share."""

    rejection: Rejection
    value: float = 0.0

    def __str__(self) -> str:
        match self.rejection:
            case Rejection.NO_CHANNEL:
                return "no channel in these data would show it"
            case Rejection.WORSE_FIT:
                return f"fits worse than the set by {self.value:.0f} in chi-square"
            case Rejection.SMALL_SHARE:
                return f"closes {100 * self.value:.0f} % of the gap"
            case Rejection.SMALL_GAIN:
                return f"chi-square falls by {self.value:.0f} only"
            case Rejection.CLEARED:
                return "a reference standard shows none"

    @property
    def rank(self) -> float:
        """Order of rejected entries: fits that came nearest first, then the share they close."""
        if self.rejection is Rejection.WORSE_FIT:
            return 1000.0 - min(round(self.value), 900.0) * 1e-3
        if self.rejection in (Rejection.NO_CHANNEL, Rejection.CLEARED):
            return -1.0
        percent = 100.0 if self.rejection is Rejection.SMALL_SHARE else 1.0
        return float(round(percent * self.value))


@dataclass(frozen=True)
class TermCourse:
    """A part of an empirical term over its one or two inputs, with its 95 % half-width.

    Attributes:
        inputs: one or two names of `plant.effects.empirical.INPUTS`.
        scale: what it is multiplied by, as in `plant.effects.empirical.SplineTerm`.
        at: values of each input, shape (points,) each.
        value, half_width: shape (points,) or (points, points), in the block's unit, or in that
            which the scale leaves.
    """

    inputs: tuple[str, ...]
    scale: str
    at: tuple[Array, ...]
    value: Array
    half_width: Array


@dataclass(frozen=True)
class NearEntry:
    """An entry of the catalogue beside an empirical term.

    Attributes:
        share: of the term's square that the entry could make.
        lacks: inputs that the term depends on and the entry does not.
        adds: inputs that the entry depends on and the term does not.
    """

    id: str
    share: float
    lacks: tuple[str, ...]
    adds: tuple[str, ...]

    def __str__(self) -> str:
        parts = [f"could make {100 * self.share:.0f} % of it"]
        if self.lacks:
            parts.append(f"does not depend on {' and '.join(self.lacks)}")
        if self.adds:
            parts.append(f"depends on {' and '.join(self.adds)} as well")
        return f"{self.id} {', '.join(parts)}"


@dataclass(frozen=True)
class Expression:
    """A short formula for an empirical term, and the fraction of the gap that it closes."""

    text: str
    closed: float


@dataclass(frozen=True)
class EmpiricalTerm:
    """What a gap looks like that no entry of the catalogue explains.

    Attributes:
        correction: the term as a plant file states it; it names the channel.
        shares: of what is closed, by input, largest first; they add up to 1.
        closed, closed_low, closed_high: fraction of the gap above the floor that the term closes
            on slots held out, with its 95 % interval (jackknife over slots).
        recalibrated, after, floor: errors on slots held out, in `unit`.
        moved: change of [constants in sd, amounts] of the fit, made together with the term.
        courses: the shape, for a figure.
        expression: a short formula that closes nearly as much; None where there is none.
        nearest: entries of the catalogue that come nearest to it, nearest first.
        told_by: the slot without which no other shows a gap: nothing can foretell what the term
            does there, and what it closes is that of the others; "" where there is no such slot.
    """

    unit: str
    correction: Correction
    shares: Mapping[str, float]
    closed: float
    closed_low: float
    closed_high: float
    recalibrated: float
    after: float
    floor: float
    moved: Array
    courses: tuple[TermCourse, ...] = ()
    expression: Expression | None = None
    nearest: tuple[NearEntry, ...] = ()
    told_by: str = ""

    @property
    def rate_share(self) -> float:
        """Share of what depends on a rate: of the length or of the pressure."""
        return sum(self.shares.get(name, 0.0) for name in ("velocity", "pressure rate"))


@dataclass(frozen=True)
class Verdict:
    """What a diagnosis found. `as_dict` gives the object of the dataset format.

    Attributes:
        status: whether the data fit, an effect was found, or nothing can be said.
        reason: why the status is what it is.
        stage: of the chain at which simulation and measurement disagree; None for none.
        effects: the effects found, each with parameters and the probability that these are all:
            what is named first, else the likeliest.
        probability_none: that no effect acts.
        probability_unknown: that something else acts: an effect that is not in the catalogue, other
            effects of it than those stated, or one too small to be seen.
        gap: of the channel that shows the effect best above its floor; decisions rest on it.
        stages: share of each stage in the gap.
        contrasts: tests between groups of trials, with their z values.
        limits: by effect, the smallest headline parameter that would have been detected.
        next_experiment: what would separate the remaining effects best.
        why_not: by effect, why it was not taken.
        notes: what a reader should know of data and result.
        evidence: figures behind the decision, as plain values.
        empirical: a correction without a physical cause, where one was fitted.
        channels: of every channel, the one with the largest gap for its range first.
        sure: effects that are there whatever else acts: all that is named, and those on which the
            entries of a set agree.
    """

    status: Status
    reason: Reason
    stage: str | None
    effects: tuple[Explanation, ...]
    probability_none: float
    probability_unknown: float
    gap: Gap | None = None
    stages: tuple[Share, ...] = ()
    contrasts: tuple[Contrast, ...] = ()
    limits: Mapping[str, float] = field(default_factory=dict)
    next_experiment: Experiment | None = None
    why_not: Mapping[str, WhyNot] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    evidence: Mapping[str, Any] = field(default_factory=dict)
    empirical: EmpiricalTerm | None = None
    channels: tuple[Gap, ...] = ()
    sure: tuple[str, ...] = ()

    def label(self, effect: Explanation) -> str:
        """Ids of an explanation as text; of what is there in any case, that it is alone."""
        alone = " alone" if self.leads and effect is self.effects[0] else ""
        return " + ".join(effect.ids) + alone

    @property
    def leads(self) -> bool:
        """Whether the first explanation is what is named, and others hold more."""
        return self.status is Status.NAMED_FORM_INADEQUATE and any(
            set(self.effects[0].ids) < set(other.ids) for other in self.effects[1:]
        )

    @property
    def headline_gap(self) -> Gap | None:
        """The gap to state first: that of the channel where it is largest for its range.

        Of a gap without a name, that of the channel whose term says what it looks like.
        """
        term = self.empirical
        if term is not None and self.status is Status.UNKNOWN:
            # Force and load have one unit: the channel is the one that was as far off.
            own = [channel for channel in self.channels if channel.unit == term.unit]
            if own:
                return min(own, key=lambda channel: abs(channel.recalibrated - term.recalibrated))
        return self.channels[0] if self.channels else self.gap

    def as_dict(self) -> dict[str, Any]:
        """The verdict as plain values: null where something does not apply, never NaN."""
        return {
            "schema": 1,
            "status": str(self.status),
            "reason": str(self.reason),
            "stage": self.stage,
            "effects": [_explanation(effect) for effect in self.effects],
            "sure": list(self.sure),
            "probability_none": _number(self.probability_none),
            "probability_unknown": _number(self.probability_unknown),
            "gap": _gap(self.gap),
            "channels": [_gap(channel) for channel in self.channels],
            "where": {
                "stages": [
                    {
                        "stage": s.stage, "share": _number(s.share),
                        "low": _number(s.low), "high": _number(s.high),
                    }
                    for s in self.stages
                ],
                "contrasts": [
                    {"name": c.name, "z": _number(c.z), "alarm": c.alarm} for c in self.contrasts
                ],
            },
            "limits": {key: _number(value) for key, value in self.limits.items()},
            "next_experiment": _experiment(self.next_experiment),
            "why_not": {name: str(why) for name, why in self.why_not.items()},
            "notes": list(self.notes),
            "evidence": plain(self.evidence),
            "empirical": _empirical(self.empirical, self.stage),
        }  # fmt: skip


def _gap(gap: Gap | None) -> dict[str, Any]:
    """Return the gap's table, all null where nothing could be compared."""
    names = (
        "unit", "before", "recalibrated", "after", "floor", "floor_source", "closed",
        "closed_low", "closed_high", "held_out",
    )  # fmt: skip
    return {name: plain(getattr(gap, name, None)) for name in names}


def _explanation(effect: Explanation) -> dict[str, Any]:
    parameters = {
        name: {"value": plain(e.value), "low": plain(e.low), "high": plain(e.high)}
        for name, e in effect.parameters.items()
    }
    return {
        "ids": list(effect.ids),
        "family": effect.family,
        "probability": _number(effect.probability),
        "parameters": parameters,
    }


def _empirical(term: EmpiricalTerm | None, stage: str | None) -> dict[str, Any] | None:
    if term is None:
        return None
    expression = term.expression
    found = {
        "channel": term.correction.block,
        "stage": stage,
        "unit": term.unit,
        "inputs": [{"input": name, "share": share} for name, share in term.shares.items()],
        "rate_share": term.rate_share,
        "closed": term.closed,
        "closed_low": term.closed_low,
        "closed_high": term.closed_high,
        "held_out": "slot",
        "told_by": term.told_by or None,
        "recalibrated": term.recalibrated,
        "after": term.after,
        "floor": term.floor,
        "expression": {"text": expression.text, "closed": expression.closed}
        if expression is not None
        else None,
        "domain": {name: list(ends) for name, ends in term.correction.domain.items()},
        "terms": [
            {
                "inputs": t.inputs,
                "scale": t.scale or None,
                "amount": None if t.inputs else t.coefficients[0],
                "period": t.period or None,
            }
            for t in term.correction.terms
        ],
        "nearest": [
            {"id": one.id, "share": one.share, "lacks": one.lacks, "adds": one.adds}
            for one in term.nearest
        ],
    }
    return dict(plain(found))


def _experiment(experiment: Experiment | None) -> dict[str, Any] | None:
    if experiment is None:
        return None
    return {
        "protocol": experiment.protocol,
        "settings": plain(experiment.settings),
        "separation_now": _number(experiment.separation_now),
        "separation_after": _number(experiment.separation_after),
        "trials": experiment.trials,
        "between": list(experiment.between),
        "why": experiment.why,
    }


def _number(value: float | None) -> float | None:
    """Return a float to six figures; None for what is not a number."""
    if value is None or not math.isfinite(value):
        return None
    return float(f"{float(value):.6g}")


def plain(value: Any) -> Any:
    """Values that JSON can carry: numpy numbers and arrays unpacked, NaN and infinity as None."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, float):
        return _number(value)
    return value
