"""Each effect of an explanation by itself: what is named where the whole is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from gap.check.presence import cases, fit
from gap.data.from_runs import open_data
from gap.decision.classify import _by_presence, _Case, _Finding
from gap.decision.config import DECISION
from gap.decision.presence import (
    FEATURES,
    Evidence,
    _left_where,
    evidence_of,
    shipped_presence,
)
from gap.errors import CheckError
from gap.estimation.discrepancy import Discrepancy
from gap.estimation.fit_problem import FitProblem
from gap.model.features import BLOCKS
from gap.reason import Cause, reason
from gap.reporting.text import headline
from gap.selection.backward import refitted_without
from gap.selection.candidate_fits import Hypothesis
from gap.selection.search import search_effects
from gap.verdict import Explanation, Status, Verdict
from gap_bench import write_set

TWO = {"bladder_elasticity": {"stiffness_n_mm": 0.8}, "leak": {"conductance_m3_s_pa": 2e-13}}


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> _Case:
    """A bench with two effects, both found."""
    folder: Path = tmp_path_factory.mktemp("two")
    problem = FitProblem.of(open_data(write_set(folder, TWO, 3, replicates=2)))
    search = search_effects(problem)
    assert set(search.best.fit.ids) == set(TWO)
    return _Case(problem, search, DECISION)


def refused(case: _Case) -> _Finding:
    """What the verdict is where the explanation as a whole is refused."""
    why = reason(Cause.OUTSIDE, names=case.names, percent=80.0)
    return _Finding(Status.UNKNOWN, why, 0.0, 0.6, named=True, entries=[(case.search.best, 0.4)])


def test_effects_that_are_there_have_a_high_probability(two: _Case) -> None:
    search, evidence = evidence_of(two.problem, two.search)
    assert search is two.search  # nothing is better
    assert min(shipped_presence().of(one) for one in evidence) > 0.9


def test_where_the_whole_is_refused_the_sure_effect_is_named_alone(two: _Case) -> None:
    odds = {"bladder_elasticity": 0.95, "leak": 0.6}
    part, found = _by_presence(two, refused(two), odds)
    assert found.status is Status.NAMED_FORM_INADEQUATE
    assert found.sure == ("bladder_elasticity",)
    assert part.search.best.fit.ids == ("bladder_elasticity",)  # fitted anew without the other
    assert part.search.left > two.search.left
    assert found.unknown == pytest.approx(0.05)
    assert "what explains the rest is not known" in str(found.reason)


def test_without_a_sure_effect_the_verdict_stays_unknown(two: _Case) -> None:
    case, found = _by_presence(two, refused(two), dict.fromkeys(TWO, 0.85))
    assert found.status is Status.UNKNOWN
    assert case is two


def test_an_effect_that_is_rather_not_there_is_not_named_with_the_rest(two: _Case) -> None:
    whole = replace(refused(two), status=Status.NAMED)
    kept = _by_presence(two, whole, {"bladder_elasticity": 0.8, "leak": 0.3})[1]
    assert kept.sure == ("bladder_elasticity",)
    assert _by_presence(two, whole, dict.fromkeys(TWO, 0.8))[1].sure == two.search.best.fit.ids


@pytest.mark.parametrize("status", [Status.INDISTINGUISHABLE, Status.MIMICABLE])
def test_an_effect_is_sure_where_others_of_the_explanation_are_open(
    two: _Case, status: Status
) -> None:
    best = two.search.best
    other = replace(best, fit=replace(best.fit, candidates=best.fit.candidates[:1]))
    open_ = replace(refused(two), status=status, entries=[(best, 0.5), (other, 0.4)])
    found = _by_presence(two, open_, {"bladder_elasticity": 0.95, "leak": 0.85})[1]
    assert found.status is status
    assert found.sure == ("bladder_elasticity",)
    assert str(found.reason).startswith("bladder_elasticity in any case")


def test_the_headline_says_that_a_part_is_not_known() -> None:
    why = reason(Cause.PARTLY, names="leak", percent=95.0, share=60.0, rest=1.2)
    entry = Explanation(("leak",), "leak", 0.95)
    verdict = Verdict(Status.NAMED_FORM_INADEQUATE, why, "chamber", (entry,), 0.0, 0.05)
    said = headline(verdict)
    assert "95 % sure" in said
    assert "the rest of the gap is not known" in said


def test_an_effect_is_the_likelier_the_less_another_can_stand_for_it() -> None:
    plain = Evidence("leak", 100.0, 5e3, 2e3, 10.0, 50.0, 5.0, 2.0, 1.0, 0.0, 0.0)
    odds = [shipped_presence().of(replace(plain, margin=margin)) for margin in (0.0, 50.0, 500.0)]
    assert odds == sorted(odds)
    assert shipped_presence().of(replace(plain, shape_at_end=1.0)) < odds[0]


def line(kind: str, margin: float, there: bool) -> dict[str, object]:
    """A line of a campaign with one effect of one explanation."""
    one = Evidence("leak", 100.0, 5e3, 2e3, margin, 50.0, 5.0, 2.0, 1.0, 0.0, 1.0)
    hidden = ["leak"] if there else ["wear"]
    score = {
        "stream": "practice", "kind": kind, "mimic": 0.1, "hidden": hidden, "truth": "effects",
    }  # fmt: skip
    return {"score": score, "verdict": {"evidence": {"presence": [one.as_dict()]}}}


def test_weights_are_learnt_from_lines_of_a_campaign() -> None:
    lines = [line("single", 1000.0, True)] * 20 + [line("single", 1.0, False)] * 20
    of = cases(lines)
    learnt = fit(of.x, of.y, of.weight)
    assert set(learnt.weights) == set(FEATURES)
    assert learnt.weights["margin"] > 0.5
    assert learnt.of(Evidence("leak", 100.0, 5e3, 2e3, 1e3, 50.0, 5.0, 2.0, 1.0, 0.0, 1.0)) > 0.8


def test_sets_with_held_out_forms_never_teach() -> None:
    bad = line("single", 1.0, True)
    bad["score"] = {**bad["score"], "stream": "held_out"}  # type: ignore[dict-item]
    with pytest.raises(CheckError, match="never teach"):
        cases([bad])


def test_a_pattern_in_another_stage_does_not_count_against_an_effect(two: _Case) -> None:
    """Chi-square that is left grows tenfold, but not where the stiffness acts."""
    problem, fit = two.problem, two.search.best.fit
    less = refitted_without(problem, fit, "bladder_elasticity")
    chamber = problem.rows.block == BLOCKS.index("pressure")
    own = ~chamber
    sd = np.sqrt(problem.floor_variance)
    before = _left_where(problem, less, fit)

    def left_with(rows: npt.NDArray[np.bool_]) -> float:
        pattern = np.where(rows, 6.0 * sd * np.sin(problem.rows.time_s), 0.0)
        with_it = [replace(f, residual=f.residual + pattern) for f in (less, fit)]
        assert problem.whitened(with_it[1].residual) > 5.0 * problem.whitened(fit.residual)
        return _left_where(problem, *with_it)

    assert left_with(chamber) < 2.0 * before
    assert left_with(own) > 10.0 * before


def test_the_discrepancy_takes_the_size_that_the_residual_has(two: _Case) -> None:
    problem, fit = two.problem, two.search.best.fit
    sd = np.sqrt(problem.floor_variance)
    force = problem.rows.block == BLOCKS.index("force")
    bent = replace(fit, residual=fit.residual + np.where(
        force, 5.0 * sd * np.cos(problem.rows.pressure / 60e3), 0.0
    ))  # fmt: skip
    made = Discrepancy(problem)
    at = made.names.index("force: pressure_kpa and length_mm")
    small, large = made.evidence(fit), made.evidence(bent)
    assert large.variance[at] > 10.0 * small.variance[at]
    assert large.log < small.log


def test_a_better_explanation_of_as_many_effects_takes_the_place_of_the_best(two: _Case) -> None:
    """A search that stopped at a stand-in for the leak is put right by the evidence."""
    problem, right = two.problem, two.search.best
    names = ("bladder_elasticity", "dead_volume")
    pair = [next(c for c in problem.candidates if c.id == name) for name in names]
    fit = problem.polish(problem.fit(pair, [c.step for c in pair]))
    poor = Hypothesis(tuple(c.key for c in pair), fit)
    assert poor.cost > right.cost
    search, evidence = evidence_of(problem, replace(two.search, best=poor, rivals=[]))
    assert set(search.best.fit.ids) == set(TWO)
    assert {one.id for one in evidence} == set(TWO)
    assert search.rivals[0] is poor
