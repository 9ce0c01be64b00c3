"""The conclusion from a sequence of tests: the last verdict, and what each test proved."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

from gap.decision.config import DECISION
from gap.design.advise import reference_for
from gap.validation.config import VALIDATION
from gap.validation.prediction import Prediction, families
from gap.verdict import Explanation, Status, Verdict

NAMED = (Status.NAMED, Status.NAMED_FORM_INADEQUATE)
SETTLED = (Status.NAMED, Status.NAMED_FORM_INADEQUATE, Status.DATA_UNFIT)
ALIKE = (Status.INDISTINGUISHABLE, Status.MIMICABLE)
UNSETTLED = (*ALIKE, Status.UNKNOWN)
"""Verdicts that a test which came out as predicted makes a name of."""


class Conclusion(StrEnum):
    """The conclusion after a sequence of tests."""

    NAMED = "named"
    NEEDS_REFERENCE = "needs reference"
    NO_GAP = "no gap"
    OPEN = "open"


@dataclass(kw_only=True)
class SequentialVerdict:
    """The last verdict, and how well each earlier explanation predicted the tests after it."""

    verdict: Verdict | None = None
    relieving: dict[str, float] = field(default_factory=dict)
    """Where there is no gap: effects that would relieve what is stated at the end of its tolerance
    (`gap.decision.at_bound`), with the gain."""
    predicted: dict[str, list[tuple[str, Prediction]]] = field(default_factory=dict)
    """By family, tests that show what was found before them, and how it fared on each."""
    ended: str | None = None
    """The fault that ended the sequence before the tests that were left; None without one."""

    @property
    def family(self) -> str | None:
        """The family of the entry that leads, where the diagnosis stops short of a name.

        None where the entry that leads is not of one family.
        """
        if self.verdict is None or self.verdict.status not in UNSETTLED:
            return None
        leading = families(self.verdict.effects[0].ids) if self.verdict.effects else frozenset()
        return next(iter(leading)) if len(leading) == 1 else None

    @property
    def agreed(self) -> str | None:
        """The family that is in every entry left, where the diagnosis stops short of a name.

        None where there is none, or more than one of them.
        """
        left = [families(ids) for ids in self._entry_ids]
        if self.verdict is None or self.verdict.status not in UNSETTLED or not left:
            return None
        common = frozenset.intersection(*left)
        return next(iter(common)) if len(common) == 1 else None

    @property
    def _others(self) -> list[frozenset[str]]:
        """Families of the entries left in which that of the leading one is not."""
        left = [families(ids) for ids in self._entry_ids]
        return [found for found in left if self.family not in found]

    @property
    def _entry_ids(self) -> list[tuple[str, ...]]:
        """Ids of the entries left that are not to be neglected."""
        if self.verdict is None:
            return []
        return [e.ids for e in self.verdict.effects if e.probability > DECISION.least_probability]

    @property
    def confirmed(self) -> tuple[str, Prediction] | None:
        """The last test that came out as predicted, if it and those before it prove it.

        They were held against each entry left, or one that shares a family with it, no later one
        spoke against it, and together they gain what a proof needs. Where its form is inexact, so
        that none comes out in full, two prove it that every rival predicts far worse.
        """
        last: tuple[str, Prediction] | None = None
        gained, outpredicted = 0.0, 0
        for protocol, found in reversed(self.predicted.get(self.family or "", [])):
            if found.refuted:
                break
            against = [families(ids) for ids in found.rivals]
            held = all(any(other & one for one in against) for other in self._others)
            if not held or not (found.share >= VALIDATION.predicted_share or found.outpredicts):
                continue
            last = last or (protocol, found)
            gained += found.gained if found.share >= VALIDATION.predicted_share else 0.0
            outpredicted += found.outpredicts
            if gained > VALIDATION.shown_chi2 or outpredicted >= VALIDATION.outpredicted_tests:
                return last
        return None

    @property
    def by_standard(self) -> frozenset[str]:
        """Families of the errors that reference standards show, where the rest has no name.

        They were measured by themselves: they are certain, whatever else acts.
        """
        if self.verdict is None or self.verdict.status not in UNSETTLED:
            return frozenset()
        return families(tuple(self.verdict.evidence.get("standards", {}).get("shown", ())))

    @property
    def of_family(self) -> list[Explanation]:
        """The entries left in which the leading family is."""
        left = self.verdict.effects if self.verdict else ()
        return [effect for effect in left if self.family in families(effect.ids)]

    @property
    def settled(self) -> bool:
        """Whether there is nothing more to find out.

        A name of several families is not settled before a test needed every one of them.
        """
        if self.verdict is None:
            return False
        if self.verdict.status not in SETTLED:
            return self.confirmed is not None
        named = families(self.verdict.effects[0].ids) if self.verdict.effects else frozenset()
        return len(named) < 2 or any(f.confirmed for _, f in self.predicted.get(joint(named), []))

    @property
    def named(self) -> str | None:
        """The family that is named, or the families that act together; None without a name.

        Of several, those that some test needed: a test that is predicted as well without a family
        is no reason to name it. All of them where no test has separated them.
        """
        if self.conclusion != Conclusion.NAMED or self.verdict is None or not self.verdict.effects:
            return None
        if self.by_standard:
            return joint(self.by_standard)
        if self.confirmed is not None:
            return self.family
        several = families(self.verdict.effects[0].ids)
        needed = {
            gone
            for _, found in self.predicted.get(joint(several), [])
            for ids, left in found.rivals.items()
            for gone in several - families(ids)
            if families(ids) == several - {gone} and left - found.left > VALIDATION.shown_chi2
        }
        if len(several) < 2 or not needed or self.settled:
            return self.verdict.effects[0].family
        return joint(frozenset(needed))

    @property
    def uncertain(self) -> bool:
        """Whether a name stands that is not certain to close half of the gap, or is of several.

        Tests that were not made yet may then show another effect, or none. So it is where nobody
        can say how much of the gap is closed, and where a few tests of one kind needed two effects:
        these may stand for one that they do not show.
        """
        if self.verdict is None or self.confirmed is not None:
            return False
        if self.verdict.status not in NAMED:
            return False
        if len(self.verdict.effects[0].ids) > 1:
            return True
        low = None if self.verdict.gap is None else self.verdict.gap.closed_low
        return low is None or low <= DECISION.closed_share

    @property
    def cut_short(self) -> bool:
        """Whether a fault ended the tests before one could prove a name of several families.

        With a blocked exhaust the board reports that the muscle does not vent, and no test follows.
        """
        return self.ended is not None and not self.settled

    @property
    def conclusion(self) -> Conclusion:
        """The conclusion that the tests so far allow."""
        assert self.verdict is not None
        status = self.verdict.status
        if self.confirmed is not None or self.by_standard:
            return Conclusion.NAMED
        if status in NAMED:
            return Conclusion.OPEN if self.cut_short else Conclusion.NAMED
        if status in ALIKE and (len(self.verdict.effects) > 1 or self.apart_by_reference):
            return Conclusion.NEEDS_REFERENCE
        if status == Status.NO_GAP_ABOVE_FLOOR:
            return Conclusion.NEEDS_REFERENCE if self.relieving else Conclusion.NO_GAP
        return Conclusion.OPEN

    @property
    def apart_by_reference(self) -> tuple[str, ...]:
        """Where the diagnosis has one entry left: what only a reference tells it from, and itself.

        Empty where a test would do, or more entries are left.
        """
        assert self.verdict is not None
        advised = self.verdict.next_experiment
        if self.verdict.status not in ALIKE or len(self.verdict.effects) != 1:
            return ()
        if advised is None or advised.protocol != "reference":
            return ()
        return tuple(dict.fromkeys(n for one in advised.between for n in one.split("+")))

    @property
    def references(self) -> dict[str, str]:
        """What would tell the entries left apart, or prove the only one, where no test did."""
        assert self.verdict is not None
        if self.verdict.status == Status.NO_GAP_ABOVE_FLOOR:
            return {name: reference_for(name) for name in self.relieving}
        if self.by_standard:
            return {}
        proven = self.confirmed is not None
        left = self.of_family if proven else self.verdict.effects
        names = dict.fromkeys(name for effect in left for name in effect.ids)
        if proven and len(names) == 1:
            return {}
        if not proven:
            if self.verdict.status not in ALIKE:
                return {}
            names |= dict.fromkeys(self.apart_by_reference)
        return {name: reference_for(name) for name in names}

    @property
    def doubted(self) -> tuple[str, ...]:
        """Effects of which a reference standard may show or rule out those of an instrument.

        Those that need a reference; and of a gap that fits nothing in the catalogue for sure, all
        that are left: an instrument is looked at before something new is.
        """
        names = dict.fromkeys(self.references)
        if self.verdict is not None and self.verdict.status == Status.UNKNOWN:
            names |= dict.fromkeys(name for ids in self._entry_ids for name in ids)
        return tuple(names)


def joint(several: frozenset[str]) -> str:
    """One word for families that act together."""
    return "+".join(sorted(several))
