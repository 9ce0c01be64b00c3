"""Recorded runs as a data set: whole, in order, and such that the plant can replay it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from analysis.reduction.points import write_table
from analysis.run_table import reduce_run
from bench_runs import run_bench
from cli.main import app
from daq.errors import RecordError
from daq.store.derive import derive
from daq.store.run import Run, open_run
from fuzz.sums import seal_anew
from gap.data.from_runs import export_runs
from gap.data.run_trials import run_trials
from gap.errors import GapError
from plant.constants import nominal
from plant.simulator.bench import BenchSim
from protocol_runs import run_short

COLUMNS = ["trial", "slot", "replicate", "protocol", "mounting", "order", "held_length_mm",
           "load_kg", "temperature_c", "start_s", "tare_length_mm", "note"]  # fmt: skip


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Run, Any]:
    root = tmp_path_factory.mktemp("runs")
    result, _, bench = run_bench(root, repeats=2)
    run = open_run(result.folder)
    derive(run, [lambda run, out: write_table(reduce_run(run), out)])
    return open_run(result.folder), bench


@pytest.fixture(scope="module")
def exported(recorded: tuple[Run, Any], tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data") / "set"
    export_runs([recorded[0]], folder)
    return folder


def test_every_trial_has_its_slot_replicate_mounting_and_order(exported: Path) -> None:
    trials = pd.read_csv(exported / "trials.csv")
    assert list(trials.columns) == COLUMNS
    assert list(trials["order"]) == [1, 2, 3, 4]
    assert sorted(trials["slot"].value_counts()) == [2, 2]
    assert set(trials["slot"]) == {"isometric:L57", "isometric:L65"}
    assert set(trials["held_length_mm"]) == {57.0, 65.0}
    assert (trials["mounting"] == "m1").all()
    assert (trials["protocol"] == "isometric").all()
    assert (np.diff(trials["start_s"]) > 0).all()
    assert (trials["temperature_c"] == 21.0).all()


def test_the_channels_are_those_of_the_record_in_engineering_units(
    exported: Path, recorded: tuple[Run, Any]
) -> None:
    samples = pd.read_parquet(exported / "samples.parquet")
    assert not samples.duplicated(["trial", "time_s"]).any()
    points = recorded[0].table
    for trial, rows in samples.groupby("trial"):
        own = points[points["trial"] == int(str(trial).rsplit(":", 1)[1])]
        lengths = rows["length_mm"].dropna()
        assert len(lengths) == len(own)
        assert lengths.to_numpy() == pytest.approx(own["length_mm"].to_numpy(), abs=1e-6)
        assert rows["pressure_kpa"].max() > 590.0
        top = own.loc[own["set_pressure_kpa"] == 600.0, "force_n"].iloc[0]
        near = rows.loc[rows["force_n"].notna(), "force_n"]
        assert abs(near - top).min() < 0.05
        assert rows["time_s"].is_monotonic_increasing


def test_the_plant_replays_the_commands_to_the_pressures_that_were_measured(
    recorded: tuple[Run, Any], exported: Path
) -> None:
    """The virtual bench runs on this plant, so its commands must lead to its pressures."""
    bench = recorded[1].plant
    constants = nominal().with_overrides(
        {"supply_kpa": 700.0, "inlet_conductance_m3_s_pa": 1.1e-10,
         "outlet_conductance_m3_s_pa": 1.1e-10, "inlet_on_ms": 2.0, "inlet_off_ms": 1.5,
         "outlet_on_ms": 2.0, "outlet_off_ms": 1.5, "inlet_on_ms_per_kpa": 0.0,
         "inlet_off_ms_per_kpa": 0.0, "outlet_on_ms_per_kpa": 0.0, "outlet_off_ms_per_kpa": 0.0,
         "outlet_normally": "open"}
    )  # fmt: skip
    assert constants == bench.constants
    for trial in list(run_trials(recorded[0]))[:2]:
        rows = trial.samples
        sim = BenchSim(constants, length_m=trial.row["held_length_mm"] * 1e-3)
        sim.advance(0.1, 0.0, 0.1)
        commands = rows[["time_s", "inlet_cmd", "outlet_cmd"]].ffill().fillna(0.0).to_numpy()
        told = np.empty(len(rows))
        for k in range(len(rows)):
            told[k] = sim.pressure_kpa
            if k + 1 < len(rows):
                span = commands[k + 1, 0] - commands[k, 0]
                sim.advance(span, span * commands[k, 1], span * commands[k, 2])
        seen = rows["pressure_kpa"].to_numpy()
        here = np.isfinite(seen)
        assert np.sqrt(np.mean((told - seen)[here] ** 2)) < 4.0
        assert np.abs(told - seen)[here].max() < 25.0


def test_the_bench_file_holds_what_the_virtual_rig_states(exported: Path) -> None:
    import tomllib

    table = tomllib.loads((exported / "bench.toml").read_text())
    assert table["supply_kpa"] == 700.0
    nominal().with_overrides(table)


def test_settled_points_alone_have_no_time_and_keep_their_direction(
    recorded: tuple[Run, Any], tmp_path: Path
) -> None:
    made = export_runs([recorded[0]], tmp_path / "points", form="points")
    samples = pd.read_parquet(tmp_path / "points" / "samples.parquet")
    assert made.rows == len(recorded[0].table) == len(samples)
    assert "time_s" not in samples
    assert set(samples["direction"]) == {"up", "down"}


def test_runs_of_one_bench_are_joined_and_a_taken_folder_is_refused(
    recorded: tuple[Run, Any], tmp_path: Path
) -> None:
    run = recorded[0]
    other = run_bench(tmp_path / "more")[1]
    made = export_runs([other, run], tmp_path / "both")
    assert made.trials == 6
    assert made.slots == 2
    trials = pd.read_csv(tmp_path / "both" / "trials.csv")
    assert trials["note"].iloc[0] == run.run_id  # the earlier one
    with pytest.raises(GapError, match="is there already"):
        export_runs([run], tmp_path / "both")


def test_runs_follow_each_other_and_other_settings_are_no_replicates(tmp_path: Path) -> None:
    """A simulated hour passes in seconds: by the clock such runs would overlap."""
    few = {"pressures_kpa": (200.0,)}
    changes = (few, few, {"pressures_kpa": (120.0,)})
    runs = [open_run(run_bench(tmp_path / "runs", repeats=1, **c)[0].folder) for c in changes]
    trials = pd.read_csv(export_runs(runs, tmp_path / "set").folder / "trials.csv")
    assert list(trials["note"]) == [run.run_id for run in runs for _ in range(2)]
    slots = ["isometric:L57", "isometric:L65"]
    assert list(trials["slot"]) == [*slots, *slots, *(f"{slot} (2)" for slot in slots)]


def test_a_hung_load_has_settled_points_and_no_force_of_the_balance(tmp_path: Path) -> None:
    """It hangs on the muscle alone, and its pictures are those of the points."""
    _, run, _ = run_short("isotonic", tmp_path)
    (trial,) = run_trials(run)
    assert not {"time_s", "force_n"} & set(trial.samples.columns)
    assert list(trial.samples["direction"]) == ["up", "up", "down", "down"]
    assert trial.samples["pressure_kpa"].tolist() == pytest.approx([150, 300, 300, 150], abs=3.0)
    assert trial.samples["length_mm"].diff().iloc[1] < -1.0
    waited = [event["waited_s"] for event in run.events if event.get("kind") == "point"]
    taken = trial.samples["taken_s"]
    assert taken.iloc[0] == pytest.approx(waited[0])
    assert np.all(np.diff(taken) >= np.array(waited[1:]) - 1e-6)


def test_a_run_without_a_whole_trial_is_refused_by_name(tmp_path: Path) -> None:
    result, run, _ = run_bench(tmp_path, repeats=1)
    lines = (result.folder / "events.jsonl").read_bytes().splitlines(keepends=True)
    kept = [n for n in lines if b'"point"' not in n and b'"trial","phase":"end"' not in n]
    (result.folder / "events.jsonl").write_bytes(b"".join(kept))
    seal_anew(result.folder)
    del run
    with pytest.raises(RecordError, match="no whole trial"):
        export_runs([open_run(result.folder)], tmp_path / "none")


def test_the_command_prints_one_json_value(recorded: tuple[Run, Any], tmp_path: Path) -> None:
    folder = recorded[0].folder
    done = CliRunner().invoke(
        app,
        ["gap", "export", "last", "--runs", str(folder.parent), "--out", str(tmp_path / "d"),
         "--json"],
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    assert json.loads(done.output)["trials"] == 4


def test_a_run_folder_is_diagnosed_like_a_data_set(recorded: tuple[Run, Any]) -> None:
    done = CliRunner().invoke(app, ["gap", "diagnose", str(recorded[0].folder), "--json"])
    assert done.exit_code == 0, done.output
    assert json.loads(done.output)["schema"] == 1
