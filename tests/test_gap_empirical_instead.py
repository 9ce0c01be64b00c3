"""A term says in whose place it stands, and over what range it holds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

import gap.decision.diagnose as diagnosing
from gap.data.reader import read_dataset
from gap.estimation.fit_problem import FitProblem
from gap.reason import Cause, Reason
from gap.reporting.empirical import INPUT_TEXT, empirical_lines
from gap.validation.empirical import empirical_term
from gap.validation.improved_plant import improved_plant
from gap.verdict import EmpiricalTerm, Status, Verdict
from plant.effects.empirical import Correction, SplineTerm
from test_gap_empirical import planted_set, waves


def plain_term(*terms: SplineTerm, instead: tuple[str, ...] = ()) -> EmpiricalTerm:
    return EmpiricalTerm(
        "N", Correction("force", terms), {"history": 1.0}, 0.8, 0.6, 0.9, 1.0, 0.3, 0.1,
        np.zeros(3), instead=instead,
    )  # fmt: skip


def lines_of(term: EmpiricalTerm) -> str:
    reason = Reason(Cause.NO_GAP)
    verdict = Verdict(Status.UNKNOWN, reason, "muscle", (), 0.1, 0.9, empirical=term)
    return "\n".join(empirical_lines(verdict))


def test_a_term_in_the_place_of_effects_is_written_without_them(tmp_path: Path) -> None:
    problem = FitProblem.of(read_dataset(planted_set(tmp_path / "data", waves)))
    term = empirical_term(problem, problem.base)
    assert term is not None
    named = problem.fit_effects(["end_cap"])
    instead = improved_plant(problem, named, replace(term, instead=("end_cap",)))
    assert "[effects.end_cap]" not in instead
    assert instead == improved_plant(problem, problem.base, term)


def test_where_a_doubtful_form_leaves_nothing_the_gap_itself_is_described(tmp_path: Path) -> None:
    problem = FitProblem.of(read_dataset(planted_set(tmp_path / "data", waves)))
    named = replace(problem.fit_effects(["end_cap"]), residual=np.zeros_like(problem.base.residual))
    search = cast(Any, SimpleNamespace(best=SimpleNamespace(fit=named), first_gain={}))
    status = Status.NAMED_FORM_INADEQUATE
    verdict = Verdict(status, Reason(Cause.NO_GAP), "muscle", (), 0.1, 0.1)
    term = diagnosing.with_empirical_term(verdict, problem, search).empirical
    assert term is not None
    assert term.instead == ("end_cap",)
    assert "in place of end_cap" in lines_of(term)
    table = replace(verdict, empirical=term).as_dict()["empirical"]
    assert table["instead_of"] == ["end_cap"]


@pytest.mark.parametrize("name", sorted(INPUT_TEXT))
def test_the_domain_gives_the_range_of_an_input_once(name: str) -> None:
    text = lines_of(plain_term(SplineTerm((name,), ((-1.0, 1.0),), (0.0, 1.0))))
    (domain,) = [line for line in text.splitlines() if line.strip().startswith("domain")]
    assert domain.count("-1") == 1
    assert domain.count(" to ") == 1
