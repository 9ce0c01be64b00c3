"""The scorer on answers and verdicts written by hand: each judgement says what it should."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from statsmodels.stats.proportion import proportion_confint

from gap.check.scoring.score import score
from gap.check.scoring.statistics import (
    Share,
    calibration_error,
    debiased_error,
    limit_of_diagnosis,
)
from gap.check.scoring.totals import totals

FAMILIES = {
    "creep": ("rate", "muscle"), "viscosity": ("rate", "muscle"), "leak": ("flow", "valve"),
    "payload": ("load", "load"), "wear": ("drift", "any"), "local_buckle": ("outside", "muscle"),
}  # fmt: skip

PARAMETERS = {"creep": {"relaxation_percent": 5.0}, "leak": {"conductance_m3_s_pa": 2e-13}}


def answer(kind: str, *ids: str, size: float = 4.0, mimic: float = 0.3, **more: Any):
    effects = [
        {"id": i, "family": FAMILIES[i][0], "stage": FAMILIES[i][1], "form": 1,
         "parameters": PARAMETERS.get(i, {})}
        for i in ids
    ]  # fmt: skip
    members = [{"id": i, "gap_over_floor": size} for i in ids]
    return {
        "stream": "smoke", "number": 0, "kind": kind, "changed": False, "table": False,
        "trials": 12, "effects": effects, "aim": size, "without": [],
        "measured": {"members": members, "mimic_index": mimic} if ids else {}, **more,
    }  # fmt: skip


def explanation(*ids: str, probability: float = 0.9, **parameters: Any):
    return {"ids": list(ids), "family": FAMILIES[ids[0]][0], "probability": probability,
            "parameters": parameters}  # fmt: skip


def verdict(status: str, *effects: dict[str, Any], none: float = 0.0, **more: Any):
    said = {"status": status, "effects": list(effects), "probability_none": none,
            "probability_unknown": more.pop("unknown", 0.0), "stage": "muscle"}  # fmt: skip
    return {**said, **more}


class TestOneSet:
    def test_the_right_name_at_the_right_place(self) -> None:
        found = score(
            answer("single", "creep"),
            verdict(
                "named",
                explanation(
                    "creep", probability=0.95,
                    relaxation_percent={"value": 5.5, "low": 4.8, "high": 6.2},
                ),
                none=0.02, unknown=0.03,
            ),
        )  # fmt: skip
        assert found["named_right"]
        assert found["family_right"]
        assert found["stage_right"]
        assert not found["wrong_name"]
        assert found["covered"]
        assert found["set_size"] == 1
        assert found["right"]
        assert found["parameter_covered"]
        assert found["error"] == pytest.approx(0.1)

    def test_a_leak_of_twice_the_conductance_is_wrong_by_all_of_it(self) -> None:
        twice = explanation("leak", conductance_m3_s_pa={"value": 4e-13, "low": 1e-13, "high": 1})
        found = score(answer("single", "leak"), verdict("named", twice))
        assert found["error"] == pytest.approx(1.0)
        assert found["ratio"] == pytest.approx(2.0)

    def test_a_sibling_is_the_right_family_and_a_wrong_name(self) -> None:
        found = score(answer("single", "creep"), verdict("named", explanation("viscosity")))
        assert found["family_right"]
        assert found["wrong_name"]
        assert not found["named_right"]

    @pytest.mark.parametrize("status", ["unknown", "no_gap_above_floor", "below_resolution"])
    def test_an_abstention_is_a_miss_and_not_a_wrong_name(self, status: str) -> None:
        found = score(answer("single", "creep"), verdict(status, stage=None, none=0.5, unknown=0.5))
        assert not found["family_right"]
        assert not found["wrong_name"]
        assert found["alarm"] == (status == "unknown")

    def test_rivals_that_fit_alike_hold_the_truth_and_name_nobody(self) -> None:
        two = explanation("viscosity", probability=0.55), explanation("creep", probability=0.42)
        found = score(answer("single", "creep"), verdict("indistinguishable", *two, none=0.03))
        assert found["holds_truth"]
        assert not found["single_name"]
        assert found["set_size"] == 2
        assert found["covered"]
        assert not found["right"]

    def test_any_alarm_at_nominal_is_false_even_unfit_and_unknown(self) -> None:
        for status in ("unknown", "data_unfit", "named"):
            effects = [explanation("creep")] if status == "named" else []
            found = score(answer("nominal"), verdict(status, *effects))
            assert found["alarm"]
        assert not score(answer("nominal"), verdict("no_gap_above_floor", none=1.0))["alarm"]

    def test_a_pair_counts_when_both_are_named_and_nothing_else(self) -> None:
        truth = answer("pair", "creep", "leak")
        assert score(truth, verdict("named", explanation("creep", "leak")))["named_right"]
        one = score(truth, verdict("named", explanation("leak")))
        assert not one["named_right"]
        assert not one["wrong_name"]
        three = score(truth, verdict("named", explanation("creep", "leak", "payload")))
        assert not three["named_right"]
        assert three["extras"] == 1

    def test_what_was_struck_from_the_catalogue_can_only_be_unknown(self) -> None:
        truth = answer("left_out", "creep", without=["creep"])
        assert truth["without"] == ["creep"]
        assert score(truth, verdict("unknown", unknown=0.95, none=0.05))["covered"]
        assert score(truth, verdict("named", explanation("viscosity")))["wrong_name"]

    def test_wear_belongs_to_no_stage(self) -> None:
        assert score(answer("single", "wear"), verdict("named", explanation("wear")))["stage_right"]


class TestTotals:
    def rows(self) -> list[dict[str, Any]]:
        quiet = verdict("no_gap_above_floor", none=0.97, unknown=0.03, stage=None)
        rows = [score(answer("nominal"), quiet) for _ in range(49)]
        rows.append(score(answer("nominal"), verdict("named", explanation("creep"))))
        rows += [score(answer("single", "creep"), verdict("named", explanation("creep")))] * 19
        rows.append(score(answer("single", "creep"), quiet))
        rows += [
            score(answer("single", "creep", mimic=0.95), verdict("named", explanation("creep")))
        ]
        rows += [
            score(answer("outside", "local_buckle"), verdict("unknown", unknown=0.9, none=0.1))
        ]
        return rows

    def table(self) -> dict[str, dict[str, Any]]:
        return {line["figure"]: line for line in totals(self.rows())["headline"]}

    def test_false_alarms_and_misses_are_counted_with_intervals(self) -> None:
        table = self.table()
        assert (table["false alarm at nominal"]["hits"], table["false alarm at nominal"]["of"]) == (
            1,
            50,
        )
        assert table["false alarm at nominal"]["met"]
        family = table["right family, gap >= 2 floors"]
        assert (family["hits"], family["of"]) == (19, 20)
        low, high = proportion_confint(19, 20, method="wilson")
        assert (family["low"], family["high"]) == pytest.approx((low, high), abs=1e-4)

    def test_mimicked_sets_stand_apart(self) -> None:
        table = self.table()
        assert table["with confounder: single name given"]["hits"] == 1
        assert table["with confounder: single name given"]["met"] is False

    def test_nothing_to_count_is_no_success(self) -> None:
        line = self.table()["both effects of a pair named, each >= 2 floors"]
        assert line["of"] == 0
        assert line["met"] is None

    def test_effects_and_confusion_list_every_single(self) -> None:
        found = totals(self.rows())
        assert [e["effect"] for e in found["effects"]] == ["creep"]
        assert found["confusion"]["3-6"]["rate"] == {"rate": 20, "none": 1}


class TestStatistics:
    def test_no_alarm_in_150_is_under_two_and_a_half_percent(self) -> None:
        assert Share(0, 150).interval[1] == pytest.approx(
            proportion_confint(0, 150, method="wilson")[1], abs=1e-6
        )

    def test_calibrated_confidences_show_no_error_once_debiased(self) -> None:
        rng = np.random.default_rng(0)
        p = rng.uniform(0.3, 1.0, 400)
        fair = (rng.random(400) < p).astype(float)
        assert calibration_error(p, fair) > 0.02  # chance alone
        assert debiased_error(p, fair) < 0.02

    def test_overconfidence_shows(self) -> None:
        p = np.full(400, 0.95)
        hits = (np.arange(400) % 10 < 7).astype(float)
        assert debiased_error(p, hits) == pytest.approx(0.25, abs=0.02)

    def test_the_limit_is_where_naming_becomes_reliable(self) -> None:
        sizes = np.array([0.5, 1.0, 2.0, 4.0, 8.0])
        assert limit_of_diagnosis(sizes, np.array([0.0, 0.0, 1.0, 1.0, 1.0])) == 2.0
        assert limit_of_diagnosis(sizes, np.array([1.0, 1.0, 1.0, 1.0, 0.0])) is None
