"""The verdict of a diagnosis, and its JSON form."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from gap.reason import Reason


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
    """One entry of the ambiguity set: effects that together explain the gap."""

    ids: tuple[str, ...]
    family: str
    probability: float
    parameters: Mapping[str, Estimate] = field(default_factory=dict)


@dataclass(frozen=True)
class Gap:
    """How large the gap is, in `unit`, and how much of it is closed.

    `closed` = (recalibrated² - after²) / (recalibrated² - floor²), on held-out data.
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

    @property
    def rank(self) -> float:
        """Order of rejected entries: fits that came nearest first, then the share they close."""
        if self.rejection is Rejection.WORSE_FIT:
            return 1000.0 - min(round(self.value), 900.0) * 1e-3
        if self.rejection is Rejection.NO_CHANNEL:
            return -1.0
        percent = 100.0 if self.rejection is Rejection.SMALL_SHARE else 1.0
        return float(round(percent * self.value))


@dataclass(frozen=True)
class Verdict:
    """What a diagnosis found. `as_dict` gives the object of the dataset format."""

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

    def as_dict(self) -> dict[str, Any]:
        """The verdict as plain values: null where something does not apply, never NaN."""
        return {
            "schema": 1,
            "status": str(self.status),
            "reason": str(self.reason),
            "stage": self.stage,
            "effects": [_explanation(effect) for effect in self.effects],
            "probability_none": _number(self.probability_none),
            "probability_unknown": _number(self.probability_unknown),
            "gap": _gap(self.gap),
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
