"""Several hidden effects at once: the sets of the blind bench, and how they are scored."""

from __future__ import annotations

import pytest

from blind.physics.entries import ENTRIES
from blind.sets import LEAST_AT_ONCE, MOST_AT_ONCE, SEVERAL, blind_set
from gap.check.several import score, totals


def test_a_set_hides_effects_of_as_many_families_on_another_muscle() -> None:
    for number in range(3):
        one = blind_set(SEVERAL, number, small=True)
        families = {ENTRIES[effect.id].family for effect in one.hidden}
        assert LEAST_AT_ONCE <= len(one.hidden) <= MOST_AT_ONCE
        assert len(families) == len(one.hidden)
        assert one.design.changed


def test_totals_count_right_and_wrong_names() -> None:
    scores = [
        {"hidden": ["a", "b"], "named": ["a", "c"], "offered": ["a", "c"], "closed": 0.9},
        {"hidden": ["d"], "named": [], "offered": ["d"], "closed": None},
    ]
    found = totals(scores)
    assert found["named"] == {
        "right": 1, "of": 3, "wrong": 1, "share": pytest.approx(1 / 3), "wrong_share": 0.5,
    }  # fmt: skip
    assert found["offered"]["right"] == 2
    assert found["closed_median"] == 0.9


@pytest.mark.campaign
def test_three_effects_at_once_are_named() -> None:
    found = score(20, 6)
    assert set(found["named"]) == set(found["hidden"])
