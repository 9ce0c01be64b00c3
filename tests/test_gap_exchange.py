"""Explanations by several effects: what enters late, what leaves again, what changes places."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from gap.data.reader import read_dataset
from gap.effects.candidates import SUSPECTS
from gap.estimation.fit_problem import Inquiry
from gap.estimation.shape_fit import shaped
from gap.selection.forward import ALARM, Naming
from gap.selection.inclusion import (
    AT_THE_END,
    BACK,
    SEEN_NEXT,
    counts,
    excess,
    most_bent,
    relieves,
    seen,
    settles,
)
from gap.selection.pruning import cleared
from gap.selection.refine import Choice, linear_gains, refine
from gap.selection.swap import exchanged, spared
from gap_bench import write_set
from gap_sets import settled_set


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Inquiry:
    """Settled points of a bench with a stiff liner and a load cell that reads 12 % too much."""
    hidden = {"liner_threshold": {"threshold_kpa": 30.0}, "force_gain": {"percent": 12.0}}
    folder = tmp_path_factory.mktemp("table") / "set"
    return Inquiry(read_dataset(settled_set(folder, hidden, replicates=4)))


def fitted(q: Inquiry, *ids: str) -> Choice:
    suspects = [next(s for s in q.suspects if s.id == name) for name in ids]
    state = q.polish(shaped(q, q.fit(suspects, [s.step for s in suspects])))
    return Choice(tuple(s.key for s in suspects), state)


def test_an_effect_that_stood_for_two_leaves_once_both_are_there(table: Inquiry) -> None:
    three = fitted(table, "fibre_stretch", "liner_threshold", "force_gain")
    two = spared(table, three, chance=30.0)
    assert two is not None
    assert two.keys == ("liner_threshold", "force_gain")
    assert two.cost < three.cost + 30.0
    assert spared(table, two, chance=30.0) is None


def test_an_effect_in_another_s_place_gives_it_back(table: Inquiry) -> None:
    wrong = fitted(table, "braid_friction", "force_gain")
    best = exchanged(table, wrong)[0]
    assert best.keys == ("liner_threshold", "force_gain")
    assert best.state.ids == best.keys
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
    q = Inquiry(data, [s for s in SUSPECTS if s.id in hidden])
    liner = fitted(q, "liner_threshold")
    both = refine(q, liner.state, liner.keys, "flow_area:outlet", *linear_gains(q, liner.state))
    assert most_bent(both.state) < BACK < AT_THE_END < most_bent(liner.state)
    assert seen(q, liner.state, both.state) < SEEN_NEXT
    assert both.state.amounts[1] == pytest.approx(0.25, abs=0.1)
    gap = excess(q, q.base)
    assert liner.cost - both.cost > 120.0, (liner.cost, both.cost, len(q.rows))
    assert counts(q, gap, ALARM, liner.state, "flow_area:outlet", both.state)

    # Nor does it leave again because held-out slots cannot tell it from the bent constant.
    assert relieves(liner.state, both.state)
    assert not relieves(both.state, liner.state)
    steps = [("liner_threshold", gap), ("flow_area:outlet", liner.cost - both.cost)]
    found = Naming(both, [], {}, gap, excess(q, both.state), steps=steps)
    assert cleared(q, found).naming.chosen.keys == both.keys


def test_what_takes_all_that_is_left_counts_beside_an_effect_of_any_size(table: Inquiry) -> None:
    """A first effect a thousand times as large makes every share of the gap small."""
    rows, gap = len(table.rows), 1e7
    liner = replace(fitted(table, "liner_threshold").state, cost=rows + 5000.0)
    both = fitted(table, "liner_threshold", "force_gain").state
    assert settles(table, gap, liner, replace(both, cost=rows + 100.0))
    assert not settles(table, gap, liner, replace(both, cost=rows + 250.0))
    small = replace(liner, cost=rows + 900.0)
    assert not settles(table, gap, small, replace(both, cost=rows + 0.0))
