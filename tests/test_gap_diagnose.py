"""What the diagnosis says of runs of the plant itself, with and without an effect."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from gap.diagnose import diagnose
from gap.inquiry import Inquiry
from gap.reader import read_dataset
from gap.verdict import STATUSES
from gap_bench import write_set


@pytest.fixture(scope="module")
def nominal_set(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_set(tmp_path_factory.mktemp("nominal"), seed=11)


def test_the_nominal_plant_has_no_gap(nominal_set: Path) -> None:
    verdict = diagnose(read_dataset(nominal_set))
    assert verdict.status == "no_gap_above_floor"
    assert not verdict.effects
    assert verdict.limits["liner_threshold"] > 0.0


@pytest.mark.parametrize(
    "effects",
    [{}, {"flow_area": {"ratio": 0.7, "side": "inlet"}}, {"end_cap": {"shortening_mm": 1.5}}],
    ids=["tolerances", "an inlet", "end caps"],
)
def test_replicates_that_are_not_alike_in_time_raise_no_noise(
    effects: dict[str, Any], tmp_path: Path
) -> None:
    # As a controller makes them: what the plant misses is then not shared.
    noise = Inquiry(read_dataset(write_set(tmp_path, effects, seed=11, late_s=0.04))).noise
    scales = (noise.scales[k] for k in ("force gain", "inlet timing", "slow pressure <"))
    gain_percent, late_ms, slow_kpa = scales
    assert gain_percent < 1.0  # 0.3 is put in
    assert late_ms < 0.1
    assert slow_kpa < 0.06


def test_a_liner_is_named_with_its_threshold(tmp_path: Path) -> None:
    write_set(tmp_path, {"liner_threshold": {"threshold_kpa": 30.0}}, seed=12)
    verdict = diagnose(read_dataset(tmp_path))
    assert verdict.status == "named"
    assert verdict.stage == "muscle"
    assert verdict.effects[0].ids == ("liner_threshold",)
    threshold = verdict.effects[0].parameters["threshold_kpa"]
    assert threshold.low < 30.0 < threshold.high  # type: ignore[operator]


def test_the_command_prints_one_object_and_no_more(nominal_set: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "rigs.cli", "gap", "diagnose", str(nominal_set), "--json"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr

    def refuse(word: str) -> Any:
        raise AssertionError(f"{word} is no JSON value")

    verdict = json.loads(done.stdout, parse_constant=refuse)
    assert verdict["schema"] == 1
    assert verdict["status"] in STATUSES
    assert {"reason", "stage", "effects", "gap", "where", "limits", "why_not"} <= set(verdict)
