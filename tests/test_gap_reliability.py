"""reliability in an explanation: what it rests on, and who may teach it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gap.check.learn import LEAF, Samples, fit, learnable
from gap.check.ledger import enter
from gap.decision.reliability import (
    FEATURES,
    OUTCOMES,
    Forest,
    features,
    for_unseen_forms,
    shipped_reliability,
)
from gap.decision.traits import at_an_end
from gap.effects.candidates import CANDIDATES
from gap.errors import CheckError

TRAITS = {
    "rows": 3000.0, "excess": 30_000.0, "left": 0.0, "repeated": 30_000.0, "repeated_left": 0.0,
    "effects": 1.0, "same_family": 0.0, "margin": 20_000.0, "more": 10.0, "bent": 1.5,
    "bent_base": 4.0, "closed": 0.98, "next_seen": 0.0, "next_gain": 10.0,
    "first_gain": 30_000.0, "last_gain": 30_000.0, "settled": 0.0, "at_an_end": 0.0,
}  # fmt: skip


def test_what_leaves_nothing_and_has_no_rival_near_is_believed() -> None:
    assert shipped_reliability().of(TRAITS)["right"] > 0.8


def test_what_leaves_most_of_a_clear_gap_is_taken_for_something_unknown() -> None:
    left = {"left": 25_000.0, "repeated_left": 25_000.0, "margin": 500.0, "closed": 0.1}
    assert shipped_reliability().of(TRAITS | left | {"bent": 3.0})["unknown"] > 0.8


def test_a_constant_at_its_wall_counts_for_little_where_next_to_nothing_is_left() -> None:
    """A strong effect in a form of its own leads a constant there as well."""
    strong = {"left": 900.0, "repeated_left": 900.0, "bent": 3.2, "bent_base": 8.0}
    assert shipped_reliability().of(TRAITS | strong)["unknown"] < 0.4


@given(
    st.fixed_dictionaries(
        {name: st.floats(-1e9, 1e9) for name in TRAITS if name not in ("left", "excess")}
        | {name: st.floats(0.0, 1e9) for name in ("left", "excess")}
    )
)
def test_probabilities_add_up_for_traits_of_any_size(traits: dict[str, float]) -> None:
    made = shipped_reliability().of(traits)
    assert sum(made.values()) == pytest.approx(1.0)
    assert min(made.values()) > 0.0


def test_a_tree_sends_a_value_on_the_cut_to_the_left() -> None:
    odds = np.array([[0.25] * 4, [1.0, 0, 0, 0], [0, 0, 0, 1.0]])
    tree = Forest(
        np.array([0]), np.array([0, -1, -1]), np.array([0.5, 0.0, 0.0]), np.array([1, -1, -1]),
        np.array([2, -1, -1]), odds,
    )  # fmt: skip
    assert tree.of([0.5])[0] == 1.0
    assert tree.of([0.51])[3] == 1.0


def test_the_stored_trees_answer_as_the_library_that_grew_them() -> None:
    ensemble = pytest.importorskip("sklearn.ensemble")
    rng = np.random.default_rng(1)
    x = rng.standard_normal((120, len(FEATURES)))
    y = (x[:, 0] + 0.3 * rng.standard_normal(120) > 0).astype(np.int64) * (1 + (x[:, 1] > 0))
    of = Samples(x, y, np.ones(120))
    twin = ensemble.RandomForestClassifier(
        200, min_samples_leaf=LEAF, max_features=0.4, random_state=0
    ).fit(x, y, of.weight)
    own = fit(of)
    expected = np.zeros((20, len(OUTCOMES)))
    expected[:, twin.classes_] = twin.predict_proba(x[:20])
    np.testing.assert_allclose([own.of(row) for row in x[:20]], expected, atol=1e-12)


def line(stream: str, number: int, changed: bool = False) -> dict[str, Any]:
    return {"score": {"stream": stream, "number": number, "changed": changed}}


def test_a_set_that_has_not_scored_yet_may_not_teach(tmp_path: Path) -> None:
    ledger = tmp_path / "ledger.csv"
    enter(ledger, range(10, 20), "1", "campaign")
    kept = learnable([line("practice", 3), line("reserved", 12), line("practice", 3)], ledger)
    assert [one["score"]["number"] for one in kept] == [3, 12]
    with pytest.raises(CheckError, match="set 20 is reserved"):
        learnable([line("reserved", 20)], ledger)


def test_changed_conditions_never_teach(tmp_path: Path) -> None:
    assert learnable([line("practice", 3, changed=True)], tmp_path / "ledger.csv") == []


@pytest.mark.parametrize(
    ("entry", "shape", "amount", "expected"),
    [
        ("pressure_gain", {}, 5.0, False),
        ("pressure_gain", {}, -30.0, True),
        ("leak", {}, 1e-13, False),
        ("leak", {}, 0.0, False),
        ("creep", {"tau_s": 20.0}, 4.0, False),
        ("creep", {"tau_s": 399.0}, 4.0, True),
    ],
)
def test_a_stand_in_is_known_by_the_end_it_was_led_to(
    entry: str, shape: dict[str, float], amount: float, expected: bool
) -> None:
    candidate = replace(next(s for s in CANDIDATES if s.id == entry), shape=shape)
    assert at_an_end(candidate, amount) is expected


def test_traits_become_features_in_the_order_the_forest_knows() -> None:
    assert features(TRAITS).shape == (len(FEATURES),)


def test_an_unseen_form_may_be_further_off_than_the_few_that_were_seen() -> None:
    """4,000 effects, each with errors of its own size: three forms foretell the fourth."""
    rng = np.random.default_rng(5)
    own = 0.25 * np.sqrt(6.0 / rng.chisquare(6.0, 4000))
    seen = np.sqrt(np.mean((own[:, None] * rng.standard_normal((4000, 3))) ** 2, axis=1))
    stated = for_unseen_forms({str(k): float(s) for k, s in enumerate(seen)})
    unseen = own * rng.standard_normal(4000)
    inside = np.abs(unseen) < 1.96 * np.array(list(stated.values()))
    alone = np.abs(unseen) < 1.96 * seen
    assert 0.95 < inside.mean() < 0.99
    assert alone.mean() < 0.9
