"""Several hidden effects at once: the sets of the blind bench, and how they are scored."""

from __future__ import annotations

import pytest

from blind.physics.entries import ENTRIES
from blind.sets import LEAST_AT_ONCE, MOST_AT_ONCE, SEVERAL, blind_set
from gap.check.several import line_of, score, totals
from gap.reason import Cause, reason
from gap.verdict import Status, Verdict


def test_a_set_hides_effects_of_as_many_families_on_another_muscle() -> None:
    for number in range(3):
        one = blind_set(SEVERAL, number, small=True)
        families = {ENTRIES[effect.id].family for effect in one.hidden}
        assert LEAST_AT_ONCE <= len(one.hidden) <= MOST_AT_ONCE
        assert len(families) == len(one.hidden)
        assert one.design.changed


def test_totals_count_right_and_wrong_names() -> None:
    scores = [
        {
            "hidden": ["a", "b"], "named": ["a", "c"], "offered": ["a", "c"], "closed": 0.9,
            "status": "named",
            "presence": [{"id": "a", "probability": 0.9}, {"id": "c", "probability": 0.9}],
        },
        {
            "hidden": ["d"], "named": [], "offered": ["d"], "closed": None, "status": "unknown",
            "presence": [{"id": "d", "probability": 0.3}],
        },
        {
            "hidden": ["e"], "named": [], "offered": [], "closed": None,
            "status": "nominal_unfit", "presence": None,
        },
    ]  # fmt: skip
    found = totals(scores)
    named = found["named"]
    assert (named["right"], named["of"], named["wrong"]) == (1, 4, 1)
    assert (named["share"], named["wrong_share"]) == (pytest.approx(1 / 4), 0.5)
    assert named["interval"] == pytest.approx((0.0456, 0.6994), abs=1e-3)  # Wilson, 1 of 4
    assert found["offered"]["right"] == 2
    assert found["closed_median"] == 0.9
    assert (found["sets"], found["unfit"], found["unknown"]) == (3, 1, 1)
    assert found["calibration"]["effects"] == 3
    assert found["calibration"]["stated_there_count"] == [(0.3, 1.0, 1), (0.9, 0.5, 2)]


def test_effects_too_small_to_be_seen_and_those_with_a_confounder_are_counted_apart() -> None:
    members = {
        "a": {"size": 4.0, "mimic": 0.2}, "b": {"size": 0.5, "mimic": 0.2},
        "c": {"size": 2.0, "mimic": 0.95},
    }  # fmt: skip
    line = {
        "hidden": ["a", "b", "c"], "named": ["a"], "offered": ["a"], "closed": 0.9,
        "status": "named", "presence": None, "members": members,
    }  # fmt: skip
    found = totals([line])
    counted = {key: (found[key]["hits"], found[key]["of"]) for key in ("of_one_floor",
               "without_confounder")}  # fmt: skip
    assert counted == {"of_one_floor": (1, 2), "without_confounder": (1, 1)}
    by_size = {key: (one["hits"], one["of"]) for key, one in found["by_size"].items()}
    assert by_size == {
        "0 to 1.5 floors": (0, 1), "1.5 to 3 floors": (0, 1), "3 to inf floors": (1, 1),
    }  # fmt: skip


def test_a_set_whose_stated_plant_is_refused_names_nothing() -> None:
    why = reason(Cause.NOMINAL_UNFIT, findings="turns would have to be off by 9 sd")
    refused = Verdict(Status.NOMINAL_UNFIT, why, None, (), 0.0, 1.0)
    line = line_of(504, ["leak", "wear", "payload"], ["wear"], refused)
    assert line["hidden"] == ["leak", "payload"]
    assert line["named"] == line["offered"] == []
    found = totals([line])
    assert (found["unfit"], found["named"]["of"]) == (1, 2)


@pytest.mark.campaign
def test_three_effects_at_once_are_named() -> None:
    found = score(20)
    assert set(found["named"]) == set(found["hidden"])
