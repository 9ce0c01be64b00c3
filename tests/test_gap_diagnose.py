"""What the diagnosis says of runs of the plant itself, with and without an effect."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from bench_process import call_pamrig
from blind.exchange import write
from blind.recording import record
from blind.sets import blind_set
from gap.data.reader import read_dataset
from gap.decision.at_bound import relieving
from gap.decision.classify import nearest_confounder
from gap.decision.config import DECISION
from gap.decision.confounders import Confounder
from gap.decision.diagnose import diagnose
from gap.effects.candidates import CANDIDATES
from gap.estimation.fit_problem import FitProblem, FitResult
from gap.selection.candidate_fits import Hypothesis, keys_of_shifted_constants
from gap.selection.search import SearchResult, search_effects
from gap.verdict import Status
from gap_bench import write_set
from gap_sets import settled_set


@pytest.fixture(scope="module")
def nominal_set(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_set(tmp_path_factory.mktemp("nominal"), seed=11)


def test_the_nominal_plant_has_no_gap(nominal_set: Path) -> None:
    verdict = diagnose(read_dataset(nominal_set))
    assert verdict.status == "no_gap_above_floor"
    assert not verdict.effects
    assert verdict.limits["liner_threshold"] > 0.0


def test_a_muscle_that_draws_air_in_while_its_load_bounces_is_no_gap(tmp_path: Path) -> None:
    # Without a reversed flow through the outlet the pressure after venting was 20 kPa off.
    write(record(blind_set("practice", 20308)), tmp_path)
    assert diagnose(read_dataset(tmp_path)).status == "no_gap_above_floor"


@pytest.mark.parametrize(
    "effects",
    [{}, {"flow_area": {"ratio": 0.7, "side": "inlet"}}, {"end_cap": {"shortening_mm": 1.5}}],
    ids=["tolerances", "an inlet", "end caps"],
)
def test_replicates_that_are_not_alike_in_time_raise_no_noise(
    effects: dict[str, Any], tmp_path: Path
) -> None:
    # As a controller makes them: what the plant misses is then not shared.
    noise = FitProblem.of(read_dataset(write_set(tmp_path, effects, seed=11, late_s=0.04))).noise
    scales = (noise.scales[k] for k in ("force gain", "inlet timing", "slow pressure <"))
    gain_percent, late_ms, slow_kpa = scales
    assert gain_percent < 1.0  # 0.3 is put in
    assert late_ms < 0.1
    assert slow_kpa < 0.06


def test_what_all_mountings_share_may_be_a_label_and_is_asked(tmp_path: Path) -> None:
    """Each muscle sits off by chance; that all sit off alike is no chance."""
    write_set(tmp_path, seed=4, replicates=2)
    trials = pd.read_csv(tmp_path / "trials.csv")
    trials["held_length_mm"] += 0.16
    trials.to_csv(tmp_path / "trials.csv", index=False)
    problem = FitProblem.of(read_dataset(tmp_path))
    own = problem.base.shift[-problem.mountings :]
    assert np.all(np.abs(own) < 3.1)  # at no wall by itself
    assert {"length_label", "camera_scale"} <= set(keys_of_shifted_constants(problem, problem.base))
    gains = relieving(problem)
    assert gains["length_label"] > DECISION.relief_gain
    assert set(gains) <= {"length_label", "camera_scale"}


def test_a_label_that_moves_no_constant_to_its_end_is_asked_for_where_it_gains_enough(
    tmp_path: Path,
) -> None:
    """0.13 mm: the mountings take a part of it each, and what is left of it the calibration."""
    write_set(tmp_path, seed=5, replicates=2)
    trials = pd.read_csv(tmp_path / "trials.csv")
    trials["held_length_mm"] += 0.13
    trials.to_csv(tmp_path / "trials.csv", index=False)
    problem = FitProblem.of(read_dataset(tmp_path))
    assert keys_of_shifted_constants(problem, problem.base) == []
    assert set(relieving(problem)) == {"length_label", "camera_scale"}


def test_agreement_that_asks_nothing_of_what_is_stated_leans_on_nothing(nominal_set: Path) -> None:
    assert relieving(FitProblem.of(read_dataset(nominal_set))) == {}


def test_an_outlet_much_later_than_a_controllers_pulses_are_long_is_found_alone(
    tmp_path: Path,
) -> None:
    """It never opens in them: by small changes of the delay a smaller outlet looks nearer."""
    late = {"valve_delay": {"delay_ms": 25.0, "edge": "outlet_on"}}
    problem = FitProblem.of(
        read_dataset(write_set(tmp_path, late, seed=3, replicates=2, late_s=0.04))
    )
    search = search_effects(problem)
    assert search.best.keys == ("valve_delay:outlet_on",)
    assert search.best.fit.amounts[0] == pytest.approx(25.0, abs=0.5)


def test_a_liner_is_named_with_its_threshold(tmp_path: Path) -> None:
    write_set(tmp_path, {"liner_threshold": {"threshold_kpa": 30.0}}, seed=12)
    verdict = diagnose(read_dataset(tmp_path))
    assert verdict.status == "named"
    assert verdict.stage == "muscle"
    assert verdict.effects[0].ids == ("liner_threshold",)
    threshold = verdict.effects[0].parameters["threshold_kpa"]
    assert threshold.low < 30.0 < threshold.high  # type: ignore[operator]


def fitted(name: str, cost: float) -> Hypothesis:
    candidate = next(s for s in CANDIDATES if s.id == name)
    none = np.empty(0)
    return Hypothesis((name,), FitResult(none, (candidate,), np.ones(1), none, cost, np.eye(1)))


def test_a_rival_that_needs_another_size_is_a_mimic_at_that_size() -> None:
    """By signatures 14 % alike, fitted it takes all but 300 of 100,000."""
    late, later = fitted("valve_delay_pressure", 3e3), fitted("valve_delay", 3.3e3)
    search = SearchResult(late, [later], {}, 1e5, 0.0)
    nearest = nearest_confounder(search, 103e3, Confounder(("pressure_lag",), 0.14))
    assert nearest is not None
    assert nearest.ids == ("valve_delay",)
    assert nearest.share == pytest.approx(0.997)


def test_the_command_prints_one_object_and_no_more(tmp_path: Path) -> None:
    settled_set(tmp_path / "set", {})
    done = call_pamrig("gap", "diagnose", tmp_path / "set", "--json")
    assert done.returncode == 0, done.stderr

    def refuse(word: str) -> Any:
        raise AssertionError(f"{word} is no JSON value")

    verdict = json.loads(done.stdout, parse_constant=refuse)
    assert verdict["schema"] == 1
    assert verdict["status"] in set(Status)
    assert {"reason", "stage", "effects", "gap", "where", "limits", "why_not"} <= set(verdict)
