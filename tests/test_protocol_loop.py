"""Closed-loop tests on virtual benches: schemes compared on steps, and a ram at its switches."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from analysis.reduction.step import figures_of_merit
from analysis.reporting.report import report_json
from daq.errors import ConfigError
from daq.store.run import Run, open_run
from rigs.execution.session import run_protocol
from rigs.protocols.names import default_rig
from rigs.protocols.registry import procedure
from rigs.rigfile.config import load_rig


def measured(root: Path, name: str, keep: list[Any] | None = None, **changes: Any) -> Run:
    config = load_rig(default_rig(name), 1)
    kind = procedure(name)
    plan = dataclasses.replace(kind.read(f"{name}-short", config), **changes)  # type: ignore[type-var]

    def start(runner: Any, record: Any) -> None:
        if keep is not None:
            keep.append(runner.rig.bench)

    result = run_protocol(kind, config, plan, root, on_start=start)
    assert result.error is None
    return open_run(result.folder)


def test_a_response_is_judged_as_by_hand() -> None:
    """200 kPa asked, 240 reached at once, then 198 swinging by 10, one switching in 100 ms."""
    t = np.arange(1000)
    kpa = np.where(t < 100, 240.0, 198.0 + 5.0 * np.where((t // 50) % 2, 1.0, -1.0))
    driven = np.zeros((1000, 2), dtype=bool)
    driven[:, 0] = (t // 50) % 2 == 1
    found = figures_of_merit(kpa, driven, goal=200.0, before=0.0, last=500, band=10.0)
    assert found["error_kpa"] == pytest.approx(2.0)
    assert found["overshoot_kpa"] == pytest.approx(40.0)
    assert found["ripple_kpa"] == pytest.approx(10.0)
    assert found["rise_s"] == 0.0
    assert found["settle_s"] == pytest.approx(0.1, abs=0.005)
    assert found["switchings_per_s"] == pytest.approx(10.0)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_mean_of_five_samples_counts_at_its_middle(sign: float) -> None:
    """It counted at its first sample: 2 ms early."""
    kpa = 300.0 + sign * np.minimum(np.arange(1000) * 0.5, 200.0)
    goal = 300.0 + sign * 200.0
    found = figures_of_merit(
        kpa, np.zeros((1000, 2), bool), goal=goal, before=300.0, last=500, band=10.25
    )
    assert found["rise_s"] == pytest.approx(0.360)
    assert found["settle_s"] == pytest.approx(0.380)


def test_a_response_that_swings_to_the_end_has_not_settled() -> None:
    t = np.arange(1000)
    kpa = 200.0 + 30.0 * np.sin(t / 30.0)
    found = figures_of_merit(
        kpa, np.zeros((1000, 2), bool), goal=200.0, before=0.0, last=500, band=10.0
    )
    assert math.isnan(found["settle_s"])
    assert found["ripple_kpa"] == pytest.approx(60.0, abs=0.5)


def test_a_falling_step_overshoots_downwards() -> None:
    kpa = np.concatenate([np.linspace(300, 80, 200), np.full(800, 100.0)])
    found = figures_of_merit(
        kpa, np.zeros((1000, 2), bool), goal=100.0, before=300.0, last=500, band=5.0
    )
    assert found["overshoot_kpa"] == pytest.approx(20.0, abs=3.0)


def test_schemes_are_told_apart_and_errors_hold_the_truth(tmp_path: Path) -> None:
    """Bursts stay on the set-point, two-position swings (docs/reference/valve-schemes.md)."""
    kept: list[Any] = []
    run = measured(tmp_path, "step", kept, pressures_kpa=(200.0, 350.0, 150.0))
    table = procedure("step").analysis.reduce(run).table.set_index(["scheme", "set_pressure_kpa"])
    assert table.loc["two", "ripple_kpa"].min() > 30.0
    assert table.loc["burst", "ripple_kpa"].max() < 5.0
    assert table.loc["burst", "settled"].all()
    board = kept[0].board
    events = [e for e in run.events if e["kind"] == "point" and e["scheme"] == "burst"]
    times = np.array(board.truth_us)
    for event in events:
        end = event["valve_seq"][1] * 1000
        truth = np.array(board.truth_kpa)[(times > end - 500_000) & (times <= end)]
        row = table.loc[("burst", event["set_pressure_kpa"])]
        error = abs(float(truth.mean()) - event["set_pressure_kpa"])
        assert abs(row["error_kpa"] - error) < 2 * row["u_error_kpa"]
    data = report_json(run)
    assert "bursts with valve model" in data["headline"]
    assert [row["name"] for row in data["results"]["schemes"]] == ["two", "burst"]


def test_the_first_step_begins_at_no_pressure_although_the_muscle_was_shortened(
    tmp_path: Path,
) -> None:
    """An outlet lets no air in: a vacuum would stay, unseen by a sensor that begins at nothing."""
    kept: list[Any] = []
    run = measured(tmp_path, "step", kept, pressures_kpa=(200.0,), schemes=("two",), length_mm=54.0)
    first = next(e for e in run.events if e["kind"] == "point")["valve_seq"][0] * 1000
    times = np.array(kept[0].board.truth_us)
    before = np.array(kept[0].board.truth_kpa)[(times > first - 50_000) & (times < first)]
    assert np.abs(before).max() < 1.0


def test_a_step_test_needs_the_valve_and_says_which_rig_has_it() -> None:
    with pytest.raises(ConfigError, match="virtual-thesis-loop"):
        procedure("step").read("step-short", load_rig("virtual-thesis"))


def test_a_ram_stops_at_each_switch_and_stays(tmp_path: Path) -> None:
    """Section 5.9, with a set-point a little above what carries the load."""
    kept: list[Any] = []
    run = measured(tmp_path, "ram", kept)
    table = procedure("ram").analysis.reduce(run).table
    assert list(table["slot"]) == ["up to A", "up to B"]
    assert table["settled"].all()
    assert (table["held_share"] == 1.0).all()
    assert (table["switchings"] == 0).all()
    assert table["u_drift_kpa"].between(0.01, 1.0).all()
    assert table["reach_s"].is_monotonic_increasing
    assert all(row["same"] for row in report_json(run)["sections"][-1]["rows"])


def test_a_ram_that_is_driven_hard_runs_through_its_switch_and_the_report_says_so(
    tmp_path: Path,
) -> None:
    run = measured(tmp_path, "ram", rise_kpa=90.0, moves=("up to A",), hold_s=0.5)
    (row,) = procedure("ram").analysis.reduce(run).table.to_dict("records")
    assert row["held_share"] < 0.5
    assert not report_json(run)["sections"][-1]["rows"][1]["same"]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('protocol = "ram"\nmoves = []\n', "moves: expected a list"),
        ('protocol = "ram"\nmoves = ["up to C"]\n', "moves[0]: 'up to C' is not one of"),
    ],
)
def test_a_bad_ram_protocol_is_refused(tmp_path: Path, text: str, said: str) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(text)
    with pytest.raises(ConfigError) as error:
        procedure("ram").read(str(file), load_rig("virtual-ram"))
    assert said in str(error.value)


def test_a_rig_without_a_ram_is_refused() -> None:
    with pytest.raises(ConfigError, match="virtual-ram"):
        procedure("ram").read("ram-short", load_rig("virtual"))
