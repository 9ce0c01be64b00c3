"""From a data set to a verdict: the public entry of the diagnosis.

verdict = diagnose(read_dataset("folder"))
verdict.status, [effect.ids for effect in verdict.effects]
"""

from __future__ import annotations

from collections.abc import Iterable

from gap.cleared import cleared
from gap.dataset import DataSet
from gap.errors import GapError
from gap.fitness import Unfit, unfit_channels
from gap.inquiry import Inquiry, State
from gap.judge import judge
from gap.naming import name_effects
from gap.suspects import SUSPECTS
from gap.verdict import Verdict
from plant.catalogue import CATALOGUE


def diagnose(data: DataSet, without: Iterable[str] = ()) -> Verdict:
    """Name the effect behind the gap of a data set, or say why it cannot be named.

    `without` strikes effects from the catalogue, as a check of how the rest takes their place.

    Raises:
        GapError: an unknown effect in `without`, or a data set in which nothing can be compared.
    """
    return examine(data, without)[0]


def examine(
    data: DataSet, without: Iterable[str] = ()
) -> tuple[Verdict, Inquiry | None, State | None]:
    """Diagnose, and hand back the fits behind the verdict as well; see `diagnose`.

    The state holds what the verdict speaks of: without what the search took in and could not prove.
    """
    struck = frozenset(without)
    for name in struck:
        if name not in CATALOGUE:
            raise GapError(
                "--without", f"unknown effect {name!r}", f"known: {', '.join(CATALOGUE)}"
            )
    unfit = unfit_channels(data)
    if unfit:
        return _unfit(unfit), None, None
    inquiry = Inquiry(data, [suspect for suspect in SUSPECTS if suspect.id not in struck])
    if not len(inquiry.rows):
        return nothing_to_compare(data), None, None
    naming = name_effects(inquiry)
    return judge(inquiry, naming), inquiry, cleared(inquiry, naming).naming.chosen.state


def _unfit(found: list[Unfit]) -> Verdict:
    first = found[0]
    return Verdict(
        status="data_unfit",
        reason="; ".join(str(unfit) for unfit in found[:3]),
        stage=None,
        effects=(),
        probability_none=0.0,
        probability_unknown=1.0,
        gap=None,
        stages=(),
        contrasts=(),
        limits={},
        next_experiment=None,
        why_not={},
        evidence={
            "unfit": [{"channel": u.channel, "defect": u.defect} for u in found],
            "first": first.trial,
        },
    )


def nothing_to_compare(data: DataSet) -> Verdict:
    """The verdict on data without any two channels that the plant relates."""
    return Verdict(
        status="below_resolution",
        reason="no trial has channels that the plant relates: pressure with force, pressure with "
        "valve commands, or pressure with a hung load and its length, each with a length",
        stage=None,
        effects=(),
        probability_none=0.5,
        probability_unknown=0.5,
        gap=None,
        stages=(),
        contrasts=(),
        limits={},
        next_experiment=None,
        why_not={},
        notes=data.notes,
    )
