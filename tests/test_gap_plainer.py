"""One number in one channel against several effects that do no more."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest

from gap.data.from_runs import open_data
from gap.decision.classify import _Case, _Finding, _unless_plainer
from gap.decision.config import DECISION
from gap.decision.confounders import plainer_channel
from gap.decision.presence import only_effects
from gap.estimation.fit_problem import FitProblem
from gap.reason import Cause, reason
from gap.selection.search import search_effects
from gap.verdict import Status
from gap_bench import write_set

BOTH = {"bladder_elasticity": {"stiffness_n_mm": 0.8}, "leak": {"conductance_m3_s_pa": 2e-13}}


@pytest.fixture(scope="module")
def off_zero(tmp_path_factory: pytest.TempPathFactory) -> _Case:
    """A load cell that shows 3 N too much, where the catalogue has no such entry."""
    folder: Path = write_set(tmp_path_factory.mktemp("zero"))
    samples = pd.read_parquet(folder / "samples.parquet")
    samples["force_n"] += 3.0
    samples.to_parquet(folder / "samples.parquet")
    whole = FitProblem.of(open_data(folder))
    problem = whole.restricted_to(lambda candidate: candidate.id not in ("force_zero", "payload"))
    return _Case(problem, search_effects(problem), DECISION)


def test_an_offset_is_likelier_than_several_effects_that_do_no_more(off_zero: _Case) -> None:
    """Practice set 44036: a payload that was struck from the catalogue had the names of four."""
    problem, search = off_zero.problem, off_zero.search
    ids = search.best.fit.ids
    assert len(ids) > 1
    assert plainer_channel(problem, search) == "force"
    # One effect is as plain.
    assert plainer_channel(problem, only_effects(problem, search, ids[:1])) is None
    # What one entry does much of, the others are beside.
    much = {"wear": 0.95 * (problem.base.cost - search.best.fit.cost)}
    assert plainer_channel(problem, replace(search, first_gain=much)) is None


def test_effects_that_are_there_are_no_single_number(tmp_path: Path) -> None:
    problem = FitProblem.of(open_data(write_set(tmp_path / "both", BOTH, replicates=2)))
    search = search_effects(problem)
    assert set(search.best.fit.ids) == set(BOTH)
    assert plainer_channel(problem, search) is None


def test_the_verdict_is_unknown_where_one_number_does_as_much(off_zero: _Case) -> None:
    search = off_zero.search
    why = reason(Cause.EXPLAINED, names="several effects")
    named = _Finding(
        Status.NAMED, why, 0.02, 0.1, named=True, sure=search.best.fit.ids,
        entries=[(search.best, 0.88)],
    )  # fmt: skip
    told = _unless_plainer(off_zero, named, search)
    assert (told.status, told.sure) == (Status.UNKNOWN, ())
    assert told.unknown == DECISION.plainer_unknown
    assert told.none + told.unknown + told.entries[0][1] == pytest.approx(1.0)
    assert "no better than one number, added to the force channel" in str(told.reason)
    # What was refused before keeps its own reason.
    refused = replace(named, status=Status.UNKNOWN)
    assert _unless_plainer(off_zero, refused, search) is refused
