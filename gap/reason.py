"""Why a verdict is what it is: a cause with its numbers, and the sentence that it makes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum


class Cause(StrEnum):
    """What decided a verdict; each stands for its sentence."""

    UNFIT_CHANNELS = "{defects}"
    DEFECT = "{meaning}"
    DEFECT_IN_TIME = "{meaning} by about {amount:.3g} ms"
    UNCERTAIN_DEFECT = (
        "a gap that a fault of the recording would explain better than any effect, but the trials "
        "do not agree on the fault"
    )
    NOMINAL_UNFIT = (
        "the nominal plant is not that of these data: {findings}. Fit a model of your muscle first "
        "(pamrig fit) and give it with --simulator, or state the muscle in bench.toml"
    )
    SIMULATOR_UNFIT = (
        "the simulator is not that of these data: {findings}. Either its tolerance does not hold, "
        "or the simulator lacks something that looks like it"
    )
    NOTHING_TO_COMPARE = (
        "no trial has channels that the plant relates: pressure with force, pressure with valve "
        "commands, or pressure with a hung load and its length, each with a length"
    )
    TOO_FEW_REPLICATES = (
        "{freedom} replicates beyond the first: too few to separate a gap from noise, {needed} are "
        "needed"
    )
    LOOKS_LIKE = (
        "the data look like {names}, but with {freedom} replicates beyond the first nothing can be "
        "told from noise"
    )
    NO_REPLICATES = (
        "{names} fits best, but what runs of one setting differ by was not measured, so nothing is "
        "named"
    )
    NO_GAP = (
        "the plant, recalibrated within its tolerances, agrees with the data to within the floor"
    )
    UNEXPLAINED = "a gap that no entry of the catalogue explains, in the {block} residual"
    CONSTANT_FAR = (
        "a gap that no entry of the catalogue explains: {constant} is led beyond its tolerance, "
        "and more than chance is left"
    )
    REPLICATES_SHARE = (
        "a gap that no entry of the catalogue explains: replicates share {sd:.1f} sd more than "
        "chance"
    )
    CONTRAST = (
        "a gap that no entry of the catalogue explains: the contrast {name} stands at {z:.1f} sd"
    )
    OUTSIDE = (
        "a gap of which the best entry ({names}) explains {percent:.0f} %, in a way that points to "
        "something the catalogue does not hold"
    )
    CALIBRATED = (
        "{names} fits best, {times:.0f} times what calibration.toml states of {key}: the "
        "calibration does not hold, or something else looks like it"
    )
    PARTLY = (
        "{names} is there ({percent:.0f} %), whatever else acts: it explains {share:.0f} % of the "
        "gap, and {rest} is not known"
    )
    PARTLY_SEVERAL = (
        "{names} are there ({percent:.0f} %), whatever else acts: they explain {share:.0f} % of "
        "the gap, and {rest} is not known"
    )
    PARTLY_OPEN = (
        "{names} ({percent:.0f} %), whatever else acts; with {open}, whose amount these data leave "
        "open, {share:.0f} % of the gap is explained"
    )
    SURE_BESIDE = "{sure} in any case; {rest}"
    LIKELY_BESIDE = "{sure} ({percent:.0f} % or more), whatever else acts; {rest}"
    UNDETERMINED = (
        "a gap that {names} would fit, but with an amount that these data leave open over its "
        "whole range or that stands at the end of it"
    )
    DRIFT_LEFT = (
        "a gap of which {names} explains a part and no drift over the trials: the contrast {name} "
        "still stands at {z:.1f} sd"
    )
    PLAINER = (
        "a gap that {names} together explain no better than one number, added to the {channel} "
        "channel: something that the catalogue does not hold is likelier than all of them"
    )
    UNRELIABLE = (
        "{names} fits best, but an explanation that looks like this one is right in "
        "{percent:.0f} % of cases only"
    )
    SEVERAL_FIT = "{names} or another entry of the set: these data fit both"
    SEVERAL_ALIKE = (
        "{names} or another entry of the set: these data fit both; {other} would look alike"
    )
    PAIR_ALIKE = "{names}, or {other} acting together"
    FORM_LEAVES = "{names} explains {percent:.0f} % of the gap; its form leaves a pattern"
    FORM_UNCERTAIN = "{names}; held out, the closed fraction is not certain to exceed one half"
    EXPLAINED = "{names} explains the gap"
    STANDARD = (
        "{names}, shown by a reference standard; with that stated, the plant agrees with the data "
        "to within the floor"
    )
    STANDARD_BESIDE = "{names}, shown by a reference standard; beside that, {rest}"
    BY_TRIAL = (
        "{names} differs between replicates: more in {count} of {trials} trials than in others"
    )


PARTS = (Cause.PARTLY, Cause.PARTLY_SEVERAL)
"""Causes of a verdict that names some effects and leaves the rest of the gap unknown."""


def rest_of(share: float) -> str:
    """What is not known where some effects are named that explain so many per cent of the gap."""
    return "whether anything else acts" if share >= _ALL else "what explains the rest"


_OF_SEVERAL = {
    "{names} fits": "{names} together fit",
    "{names} explains": "{names} together explain",
    "its form leaves": "their forms leave",
}
_ALL = 99.5
"""Per cent of the gap that are written as 100."""


@dataclass(frozen=True)
class Reason:
    """A cause and what its sentence names."""

    cause: Cause
    values: Mapping[str, object] = field(default_factory=dict)

    def __str__(self) -> str:
        text = self.cause.value
        if " and " in str(self.values.get("names", "")):
            for one, several in _OF_SEVERAL.items():
                text = text.replace(one, several)
        return text.format(**self.values)


def reason(cause: Cause, **values: object) -> Reason:
    """A reason with the names and numbers of its sentence."""
    return Reason(cause, values)
