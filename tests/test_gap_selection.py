"""Explanations by several effects: what enters late, what leaves again, what changes places."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from gap.data.reader import read_dataset
from gap.effects.candidates import CANDIDATES
from gap.estimation.fit_problem import FitProblem
from gap.selection.backward import drop_needless, swapped
from gap.selection.candidate_fits import fit_further, linear_gains
from gap.selection.config import SELECTION
from gap.selection.inclusion import (
    StepStatistics,
    excess_chi2,
    is_included,
    leaves_nothing,
    relieves_constant,
    step_statistics,
)
from gap.selection.pruning import prune
from gap.selection.search import SearchResult, _merged
from gap_bench import write_set
from gap_sets import fitted, table_with_two_effects


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> FitProblem:
    return table_with_two_effects(tmp_path_factory.mktemp("table") / "set")


def test_an_effect_that_stood_for_two_leaves_once_both_are_there(table: FitProblem) -> None:
    three = fitted(table, "fibre_stretch", "liner_threshold", "force_gain")
    two = drop_needless(table, three, chance=30.0)
    assert two is not None
    assert two.keys == ("liner_threshold", "force_gain")
    assert two.cost < three.cost + 30.0
    assert drop_needless(table, two, chance=30.0) is None


def test_an_effect_by_way_of_which_the_others_found_their_end_leaves_again(
    table: FitProblem,
) -> None:
    """Withheld bench 1051: a valve delay of nothing stood beside a gauge, with a gain of 176."""
    with_wear = fitted(table, "liner_threshold", "force_gain", "wear")
    two = drop_needless(table, with_wear, chance=30.0)
    assert two is not None
    assert two.keys == ("liner_threshold", "force_gain")


def test_the_gain_of_a_step_that_is_taken_back_counts_to_its_neighbour() -> None:
    """Two of a family became one, then the last effect left: a step too many broke the search."""
    steps = (("gauge", 900.0), ("tube", 50.0), ("wear", 30.0))
    assert _merged(steps, -2) == (("gauge", 900.0), ("wear", 80.0))
    assert _merged(steps, -1) == (("gauge", 900.0), ("tube", 80.0))
    assert _merged(_merged(steps, -2), -1) == (("gauge", 980.0),)


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
    data = read_dataset(write_set(tmp_path, hidden, seed=4, replicates=2, rate_hz=1000.0))
    problem = FitProblem.of(data, [s for s in CANDIDATES if s.id in hidden])
    liner = fitted(problem, "liner_threshold")
    linear = linear_gains(problem, liner.fit)
    both = fit_further(problem, liner, "flow_area:outlet", linear)
    gap = excess_chi2(problem, problem.base)
    step = step_statistics(problem, gap, SELECTION.least_gain, liner.fit, both.fit)
    assert step.shift_after < SELECTION.freed_to_sd < SELECTION.freed_from_sd < step.shift_before
    strict = replace(SELECTION, further_visibility=0.6)
    assert step.visibility < strict.further_visibility
    assert both.fit.amounts[1] == pytest.approx(0.25, abs=0.1)
    assert step.gain > 120.0, (liner.cost, both.cost, len(problem.rows))
    assert is_included(step, strict)

    # Nor does it leave again because held-out slots cannot tell it from the bent constant.
    assert relieves_constant(step)
    assert not relieves_constant(
        step_statistics(problem, gap, SELECTION.least_gain, both.fit, liner.fit)
    )
    steps = (("liner_threshold", gap), ("flow_area:outlet", step.gain))
    found = SearchResult(both, [], {}, gap, excess_chi2(problem, both.fit), steps=steps)
    assert prune(problem, found).search.best.keys == both.keys


def test_what_takes_all_that_is_left_counts_beside_an_effect_of_any_size(table: FitProblem) -> None:
    """A first effect a thousand times as large makes every share of the gap small."""
    rows, gap = len(table.rows), 1e7
    liner = fitted(table, "liner_threshold").fit
    both = fitted(table, "liner_threshold", "force_gain").fit

    def nothing_is_left(before: float, after: float) -> bool:
        one, two = replace(liner, cost=rows + before), replace(both, cost=rows + after)
        return leaves_nothing(step_statistics(table, gap, SELECTION.least_gain, one, two))

    assert nothing_is_left(5000.0, 100.0)
    assert not nothing_is_left(5000.0, 250.0)
    assert not nothing_is_left(900.0, 0.0)


def further(**changes: float | bool | str) -> StepStatistics:
    """A further effect of 9 sd that hardly shows in any block."""
    plain = StepStatistics(
        key="dead_volume", gain=900.0, gap=1e4, left=1000.0, rows=5000, alarm=30.0,
        visibility=0.2, own_channels=False, same_family=False, best_of_family=True,
        shift_before=0.5, shift_after=0.5, frees=False,
    )  # fmt: skip
    return replace(plain, **changes)  # type: ignore[arg-type]


def test_beside_what_leaves_nothing_an_effect_need_not_be_visible() -> None:
    """There is no form that it could correct, so its gain alone says whether it is there."""
    alone = {"gain": 127.0, "left": 0.0, "gap": 62000.0}
    assert is_included(further(**alone))
    assert not is_included(further(**alone, same_family=True))
    assert not is_included(further(**{**alone, "gain": 40.0}))
    assert not is_included(further(**{**alone, "left": 3000.0}))


def test_an_effect_of_few_rows_counts_by_the_share_that_it_takes() -> None:
    few = {"gain": 11000.0, "left": 18000.0, "gap": 100000.0}
    assert is_included(further(**few))
    assert not is_included(further(**{**few, "gap": 1e6}))
    assert not is_included(further(**{**few, "gain": 8000.0}))


def test_a_visible_effect_counts_beside_a_form_that_leaves_much() -> None:
    beside = {"gain": 4800.0, "left": 10800.0, "gap": 330000.0, "visibility": 1.4}
    assert is_included(further(**beside))
    assert not is_included(further(**{**beside, "visibility": 0.9}))
    assert not is_included(further(**{**beside, "gain": 800.0}))
    assert not is_included(further(**{**beside, "gap": 1e6}))
