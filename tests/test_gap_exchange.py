"""Explanations by several effects: what enters late, what leaves again, what changes places."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from gap.data.reader import read_dataset
from gap.effects.candidates import SUSPECTS
from gap.estimation.fit_problem import FitProblem
from gap.estimation.shape_fit import fit_shapes
from gap.selection.forward import ALARM, SearchResult
from gap.selection.inclusion import (
    AT_THE_END,
    BACK,
    SEEN_NEXT,
    excess_chi2,
    largest_shift,
    leaves_nothing,
    passes_inclusion_test,
    relieves_constant,
    visibility,
)
from gap.selection.pruning import prune
from gap.selection.refine import Hypothesis, linear_gains, refine
from gap.selection.swap import drop_needless, swapped
from gap_bench import write_set
from gap_sets import settled_set


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> FitProblem:
    """Settled points of a bench with a stiff liner and a load cell that reads 12 % too much."""
    hidden = {"liner_threshold": {"threshold_kpa": 30.0}, "force_gain": {"percent": 12.0}}
    folder = tmp_path_factory.mktemp("table") / "set"
    return FitProblem.of(read_dataset(settled_set(folder, hidden, replicates=4)))


def fitted(problem: FitProblem, *ids: str) -> Hypothesis:
    candidates = [next(s for s in problem.candidates if s.id == name) for name in ids]
    fit = problem.polish(fit_shapes(problem, problem.fit(candidates, [s.step for s in candidates])))
    return Hypothesis(tuple(s.key for s in candidates), fit)


def test_an_effect_that_stood_for_two_leaves_once_both_are_there(table: FitProblem) -> None:
    three = fitted(table, "fibre_stretch", "liner_threshold", "force_gain")
    two = drop_needless(table, three, chance=30.0)
    assert two is not None
    assert two.keys == ("liner_threshold", "force_gain")
    assert two.cost < three.cost + 30.0
    assert drop_needless(table, two, chance=30.0) is None


def test_an_effect_in_another_s_place_gives_it_back(table: FitProblem) -> None:
    wrong = fitted(table, "braid_friction", "force_gain")
    best = swapped(table, wrong)[0]
    assert best.keys == ("liner_threshold", "force_gain")
    assert best.fit.ids == best.keys
    assert best.cost < 0.1 * wrong.cost


def test_an_effect_whose_place_a_constant_took_counts_although_it_shows_little(
    tmp_path: Path,
) -> None:
    """A constant led beyond its tolerance hides it from the residual, at a price."""
    hidden = {
        "liner_threshold": {"threshold_kpa": 30.0},
        "flow_area": {"side": "outlet", "ratio": 1.25},
    }
    data = read_dataset(write_set(tmp_path, hidden, seed=4, replicates=2))
    problem = FitProblem.of(data, [s for s in SUSPECTS if s.id in hidden])
    liner = fitted(problem, "liner_threshold")
    both = refine(
        problem, liner.fit, liner.keys, "flow_area:outlet", *linear_gains(problem, liner.fit)
    )
    assert largest_shift(both.fit) < BACK < AT_THE_END < largest_shift(liner.fit)
    assert visibility(problem, liner.fit, both.fit) < SEEN_NEXT
    assert both.fit.amounts[1] == pytest.approx(0.25, abs=0.1)
    gap = excess_chi2(problem, problem.base)
    assert liner.cost - both.cost > 120.0, (liner.cost, both.cost, len(problem.rows))
    assert passes_inclusion_test(problem, gap, ALARM, liner.fit, "flow_area:outlet", both.fit)

    # Nor does it leave again because held-out slots cannot tell it from the bent constant.
    assert relieves_constant(liner.fit, both.fit)
    assert not relieves_constant(both.fit, liner.fit)
    steps = [("liner_threshold", gap), ("flow_area:outlet", liner.cost - both.cost)]
    found = SearchResult(both, [], {}, gap, excess_chi2(problem, both.fit), steps=steps)
    assert prune(problem, found).search.best.keys == both.keys


def test_what_takes_all_that_is_left_counts_beside_an_effect_of_any_size(table: FitProblem) -> None:
    """A first effect a thousand times as large makes every share of the gap small."""
    rows, gap = len(table.rows), 1e7
    liner = replace(fitted(table, "liner_threshold").fit, cost=rows + 5000.0)
    both = fitted(table, "liner_threshold", "force_gain").fit
    assert leaves_nothing(table, gap, liner, replace(both, cost=rows + 100.0))
    assert not leaves_nothing(table, gap, liner, replace(both, cost=rows + 250.0))
    small = replace(liner, cost=rows + 900.0)
    assert not leaves_nothing(table, gap, small, replace(both, cost=rows + 0.0))
