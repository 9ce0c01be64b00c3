"""`pamrig simulate`: scenarios read, run, recorded; and refused with file and key."""

from __future__ import annotations

import dataclasses
import json
import subprocess
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import pamrig
from analysis.findings.simulation import scene_figure
from analysis.formats.export import export_run
from analysis.reporting.derived import derive_all
from analysis.run_table import reduce_run
from bench_process import call_pamrig
from daq.errors import ConfigError, RecordError
from daq.interrupt import StopFlag
from daq.store.run import open_run
from daq.store.verify import verify
from gap.data.from_runs import export_runs
from gap.data.reader import read_dataset
from rigs.rigfile.toml_reader import find_config
from studies.simulation.scenario import load_scenario
from studies.simulation.session import build_scene, simulate

SHIPPED = ("antagonists", "finger", "held-steps", "hung-two-position", "ram", "spring-return")


def scenario_text(name: str = "antagonists") -> str:
    return find_config(name, "scenarios")[0]


def written(folder: Path, text: str) -> str:
    path = folder / "mine.toml"
    path.write_text(text)
    return str(path)


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("runs")


@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_scenario_leaves_a_sound_run(name: str, runs: Path) -> None:
    scenario = load_scenario(name)
    result = simulate(scenario, runs)
    assert result.outcome == "clean", result.reason
    assert not verify(open_run(result.folder))
    run = open_run(result.folder)
    truth = run.samples("truth")
    assert len(truth["row"]) == round(scenario.duration_s * 1e3) + 100  # and the venting after it
    assert scene_figure(run).axes[2].get_xlabel() == "time (s)"


def test_what_is_read_is_what_is_there_but_for_noise(runs: Path) -> None:
    run = open_run(simulate(load_scenario("held-steps"), runs).folder)
    valve, truth = run.samples("valve"), run.samples("truth")
    read = run.calibration("pressure_kpa").apply(valve["counts"])
    true = np.interp(valve["host_ns"], truth["host_ns"], truth["muscle_pressure_kpa"])
    # Telemetry stamps frames of 32 samples by their arrival: compare where the pressure stands.
    calm = (valve["host_ns"] > 3.2e9) & (valve["host_ns"] < 4.0e9)
    assert np.std((read - true)[calm]) == pytest.approx(0.5, abs=0.08)
    pull = run.calibration("force_n").apply(run.samples("balance")["grams"])
    assert pull[-1] == pytest.approx(truth["muscle_force_n"][-1], abs=0.3)


def test_the_notebook_gets_table_and_streams(runs: Path) -> None:
    run = pamrig.simulate("antagonists", runs)
    table = run.table
    assert list(table["slot"]) == ["W1", "W2"]
    assert table["pressure_kpa"].iloc[0] == pytest.approx(200.0, rel=0.05)
    angle = run.stream("place")["elbow_deg"]
    assert angle.iloc[-1] > 10.0
    assert run.stream("valve-extensor")["counts"].max() > 0
    assert (run.run.folder / "derived" / "report.html").read_text().count("Motion") >= 1


@pytest.mark.parametrize("name", SHIPPED)
def test_what_runs_are_for_works_on_a_simulated_one(name: str, tmp_path: Path) -> None:
    """Report, view and export, and the conversion for a diagnosis or why there is none."""
    run = derive_all(simulate(load_scenario(name), tmp_path / "runs").folder)
    derived = {path.name for path in (run.folder / "derived").iterdir()}
    assert {"report.html", "view.rrd", "table.parquet"} <= derived
    truth = {path.name: path for path in export_run(run, "parquet", tmp_path / "out")}
    assert len(pd.read_parquet(truth["truth.parquet"])) > 1000
    if load_scenario(name).mechanism.kind in ("held", "hung"):
        for form in ("time", "points"):
            made = export_runs([run], tmp_path / form, form=form)
            assert made.trials == 1
            assert read_dataset(made.folder).trials[0].slot
    else:
        with pytest.raises(RecordError, match="a data set holds trials of one muscle"):
            export_runs([run], tmp_path / "set")


def test_a_held_muscle_is_one_whole_trial_at_its_length(runs: Path, tmp_path: Path) -> None:
    text = scenario_text("held-steps") + (
        "[plant]\nsupply_kpa = 600\n[effects.leak]\nconductance_m3_s_pa = 1e-11\n"
    )
    run = open_run(simulate(load_scenario(written(tmp_path, text)), runs).folder)
    made = export_runs([run], tmp_path / "set")
    trial = pd.read_csv(made.folder / "trials.csv").iloc[0]
    assert trial["held_length_mm"] == 60.0
    samples = pd.read_parquet(made.folder / "samples.parquet")
    assert samples["time_s"].iloc[-1] == pytest.approx(4.0, abs=0.05)
    assert samples["length_mm"].mean() == pytest.approx(60.0, abs=0.05)
    assert samples["inlet_cmd"].max() == 1.0
    # Its constants are told, its effects are not.
    assert (made.folder / "bench.toml").read_text() == "supply_kpa = 600.0\n"


def test_a_hung_load_is_told_as_it_is_said_to_be(runs: Path, tmp_path: Path) -> None:
    text = scenario_text("hung-two-position") + "[effects.payload]\nmass_kg = 0.5\n"
    run = open_run(simulate(load_scenario(written(tmp_path, text)), runs).folder)
    made = export_runs([run], tmp_path / "set")
    assert pd.read_csv(made.folder / "trials.csv")["load_kg"].iloc[0] == 3.0
    read = pd.read_parquet(made.folder / "samples.parquet")["length_mm"].dropna()
    # As the sensor of place read them, 50 a second for 4 s.
    assert len(read) == 200
    assert set(read) <= set(run.samples("place")["length_mm"])


@pytest.mark.parametrize("name", ["antagonists", "hung-two-position"])
def test_halving_the_step_changes_no_row_of_the_table(name: str, runs: Path) -> None:
    scenario = load_scenario(name)
    tables = []
    for share in (1.0, 0.5):
        halved = dataclasses.replace(scenario, step_share=share)
        run = open_run(simulate(halved, runs).folder)
        tables.append(reduce_run(run).table[["pressure_kpa", "length_mm", "force_n"]])
    assert (tables[0] / tables[1] - 1.0).abs().to_numpy().max() < 1e-3


def test_two_runs_of_one_seed_are_equal_to_the_bit(runs: Path) -> None:
    first, second = (simulate(load_scenario("ram"), runs).folder for _ in range(2))
    for name in ("valve", "place", "truth", "edges"):
        a, b = (open_run(folder).samples(name) for folder in (first, second))
        assert all(np.array_equal(a[key], b[key]) for key in a)


def test_a_stop_keeps_what_was_simulated(runs: Path) -> None:
    flag = StopFlag()

    def progress(now_s: float, whole_s: float) -> None:
        if now_s >= 1.0:
            flag.set("SIGINT")

    result = simulate(load_scenario("held-steps"), runs, stop=flag, progress=progress)
    assert result.outcome == "stopped"
    run = open_run(result.folder)
    assert not verify(run)
    assert 1100 <= len(run.samples("truth")["row"]) <= 1110


def test_a_fault_of_the_firmware_ends_the_run_and_is_named(runs: Path, tmp_path: Path) -> None:
    text = scenario_text("held-steps").replace('"burst"', '"two"')
    text += "\n[controller]\nparameters = { trip = 700, sp_max = 700 }\n"
    result = simulate(load_scenario(written(tmp_path, text)), runs)
    assert result.outcome == "faulted"
    assert "over_pressure" in result.reason
    assert "muscle" in result.reason


def test_a_command_that_the_firmware_refuses_ends_the_run(runs: Path, tmp_path: Path) -> None:
    text = scenario_text("held-steps").replace("setpoint_kpa = 350", "setpoint_kpa = 700")
    result = simulate(load_scenario(written(tmp_path, text)), runs)
    assert result.outcome == "faulted"
    assert "refused" in result.reason


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('joint = "elbow"\npulls', 'joint = "elbw"\npulls', "unknown joint 'elbw'"),
        ("mass_g = 200.0", "mass_g = -200.0", "negative mass"),
        ("payload_g = 50.0", "payload_g = -50.0", "payload_g: negative mass"),
        (
            "rod_diameter_mm = 25.0",
            "com_mm = [-60, 0, 0]\ninertia_g_mm2 = [1.0, 1.0, 9.0, 0, 0, 0]",
            "not a valid inertia",
        ),
        ("rest_mm = 62.0", "rest_mm = 95.0", "outside the braid"),
        ("rest_mm = 62.0", "rest_mm = 82.0", "outside the braid"),
        ('name = "elbow"', 'name = "wrist"', "unknown joint 'wrist'"),
        ("duration_s = 4.0", "duration_s = -1", "duration_s"),
        ("seed = 1", "sed = 1", "unknown key"),
        ('scheme = "burst"', 'scheme = "brst"', "scheme"),
        ('muscle = "flexor"', 'muscle = "flexo"', "no muscle named 'flexo'"),
        ("setpoint_kpa = 320", "setpoint_kpa = 320\nscheme = 'two'", "one of scheme"),
        ("at_s = 3.2\nseconds", "at_s = 3.9\nseconds", "window ends after"),
        ('kind = "joint"', 'kind = "jiont"', "load.kind"),
        ("radius_mm = 8.0", "radius_mm = 8.0\nmodel = 'chou'", "model"),
        ("start_deg = 0.0", "start_deg = 80.0", "start_deg"),
        ("seed = 1", "seed = 1\n[plant]\nsupply_kpa = 9000\n", "supply_kpa"),
        ("seed = 1", "seed = 1\n[effects.leek]\nx = 1\n", "leek"),
        ("rest_mm = 62.0", "rest_mm = 62.0\nparameters = { two_ded = 5 }", "two_ded"),
        ("rest_mm = 62.0", "rest_mm = 57.0", "from 48.6 to 65.4 mm, outside the braid's 51"),
        ("rest_mm = 62.0", "rest_m = 0.062", "is 'rest_m' meant for it?"),
        ("rest_mm = 62.0", "rest_mm = nan", "rest_mm: nan mm is outside"),
        ("duration_s = 4.0", "duration_s = inf", "duration_s: inf s is outside"),
        ("duration_s = 4.0", "duration_s 4.0", "not valid TOML"),
        ("mass_g = 200.0", "mass_kg = 0.2", "did you mean mass_g?"),
        ("range_deg = [-60.0, 60.0]", "range_deg = [60.0, -60.0]", "got 60 to -60 degrees"),
        ("seed = 1", "seed = 1\nplant = 3\n", "plant: expected a table, got 3"),
        ("seed = 1", "seed = 1\neffects = 'leak'\n", "effects: expected a table"),
        ("rest_mm = 62.0", "rest_mm = 62.0\nplant = 3", "muscle[1].plant: expected a table"),
        ("seed = 1", "seed = 1\nplant_base = 'nope'\n", "plant_base: plant 'nope'"),
        ("seed = 1", "seed = 1\n[plant]\nsupply_bar = 5.5\n", "did you mean supply_kpa?"),
        ("payload_g = 50.0", "payload_kg = 0.05", "did you mean 'payload_g'?"),
        ('name = "flexor"', 'name = " "', "muscle[1].name: is empty"),
    ],
)  # fmt: skip
def test_a_bad_scenario_is_refused_with_file_and_key(
    old: str, new: str, words: str, tmp_path: Path
) -> None:
    text = scenario_text()
    assert old in text
    path = written(tmp_path, text.replace(old, new, 1))

    def build() -> None:
        build_scene(load_scenario(path))

    with pytest.raises(ConfigError) as caught:
        build()
    assert words in str(caught.value)
    assert "mine.toml" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_command_line_refuses_with_status_2_and_prints_json(tmp_path: Path) -> None:
    def pamrig_command(*words: str) -> subprocess.CompletedProcess[str]:
        return call_pamrig("simulate", *words, "--out", tmp_path / "runs")

    bad = written(tmp_path, scenario_text().replace("mass_g = 200.0", "mass_g = -200.0"))
    done = pamrig_command(bad)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "mine.toml" in done.stderr
    assert not (tmp_path / "runs").exists()
    done = pamrig_command("held-steps", "--json")
    assert done.returncode == 0
    assert json.loads(done.stdout)["outcome"] == "clean"
