"""A valve whose delay is not the same at each stroke: what that leaves is no unknown effect."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gap.data.reader import read_dataset
from gap.effects.candidates import SUSPECTS
from gap.estimation.agreement import shared_chi2
from gap.estimation.fit_problem import FitProblem
from gap.selection.candidate_fits import Hypothesis
from gap.selection.inclusion import excess_chi2
from gap.selection.per_stroke import with_per_stroke_delays
from gap.selection.search import SearchResult
from gap_bench import per_stroke, write_set

LATE_S = (5.4e-3, 4.4e-3, 4.8e-3, 5.6e-3, 4.6e-3, 5.2e-3, 4.5e-3, 5.5e-3)
"""Delays of a valve that is 5 ms late, a tenth of it more or less at each stroke."""


def late_outlet(folder: Path, opens_late_s: tuple[float, ...]) -> tuple[FitProblem, SearchResult]:
    data = read_dataset(write_set(folder, seed=3, replicates=2, opens_late_s=opens_late_s))
    problem = FitProblem.of(data)
    candidate = next(s for s in SUSPECTS if s.key == "valve_delay:outlet_on")
    fit = problem.polish(problem.fit([candidate], [5.0]))
    left = excess_chi2(problem, fit)
    return problem, SearchResult(
        Hypothesis((candidate.key,), fit), [], {}, excess_chi2(problem, problem.base), left
    )


@pytest.fixture(scope="module")
def irregular(tmp_path_factory: pytest.TempPathFactory) -> tuple[FitProblem, SearchResult]:
    return late_outlet(tmp_path_factory.mktemp("irregular") / "set", LATE_S)


def test_strokes_that_differ_leave_much_of_a_gap_and_next_to_nothing_once_they_may(
    irregular: tuple[FitProblem, SearchResult],
) -> None:
    problem, search = irregular
    better = with_per_stroke_delays(problem, search)
    assert search.left > 0.05 * search.gap
    assert better.left < 0.1 * search.left
    assert better.best is search.best
    assert shared_chi2(problem, better.remaining.residual) < 0.2 * shared_chi2(
        problem, search.remaining.residual
    )


def test_constants_that_uneven_strokes_had_bent_come_back(
    irregular: tuple[FitProblem, SearchResult],
) -> None:
    problem, search = irregular
    before, after = search.remaining.shift, with_per_stroke_delays(problem, search).remaining.shift
    assert np.abs(after).max() < np.abs(before).max()


def test_strokes_of_an_effect_that_is_no_delay_stay_as_they_are(
    irregular: tuple[FitProblem, SearchResult],
) -> None:
    problem, _ = irregular
    candidate = next(s for s in SUSPECTS if s.id == "leak")
    fit = problem.fit([candidate], [candidate.step])
    search = SearchResult(
        Hypothesis(("leak",), fit),
        [],
        {},
        excess_chi2(problem, problem.base),
        excess_chi2(problem, fit),
    )
    assert with_per_stroke_delays(problem, search) is search
    assert search.remaining is fit


def test_a_delay_that_grows_a_millisecond_a_stroke_is_no_uneven_one(tmp_path: Path) -> None:
    """A coil that warms is late by more and more, far beyond a tenth."""
    problem, search = late_outlet(tmp_path / "set", tuple((2.0 + k) * 1e-3 for k in range(8)))
    assert with_per_stroke_delays(problem, search).left > 0.2 * search.left


def test_the_bench_of_these_tests_opens_late_by_what_it_was_told() -> None:
    events = [(1.0, "outlet", 1.0), (1.1, "outlet", 0.0), (2.0, "outlet", 1.0)]
    assert per_stroke(events, (0.1, 0.2)) == [
        (1.1, "outlet", 1.0), (1.1, "outlet", 0.0), (2.2, "outlet", 1.0),
    ]  # fmt: skip
