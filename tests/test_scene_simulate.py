"""`pamrig simulate`: scenarios read, run, recorded; and refused with file and key."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import pamrig
from daq.errors import ConfigError
from daq.run import open_run
from daq.verify import verify
from rigs.interrupt import StopFlag
from rigs.simulation.findings import scene_figure
from rigs.simulation.scenario import load_scenario
from rigs.simulation.session import build_scene, simulate
from rigs.toml_reader import find_config

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
    result = simulate(scenario, runs, derive=name == "antagonists")
    assert result.outcome == "clean", result.reason
    assert not verify(open_run(result.folder))
    run = open_run(result.folder)
    truth = run.samples("truth")
    assert len(truth["row"]) == round(scenario.duration_s * 1e3) + 100  # and the venting after it
    assert scene_figure(run).axes[2].get_xlabel() == "time (s)"


def test_what_is_read_is_what_is_there_but_for_noise(runs: Path) -> None:
    run = open_run(simulate(load_scenario("held-steps"), runs, derive=False).folder)
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
    assert (run.run.folder / "derived" / "report.html").read_text().count("What moved") >= 1


def test_two_runs_of_one_seed_are_equal_to_the_bit(runs: Path) -> None:
    first, second = (simulate(load_scenario("ram"), runs, derive=False).folder for _ in range(2))
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
    result = simulate(load_scenario(written(tmp_path, text)), runs, derive=False)
    assert result.outcome == "faulted"
    assert "over_pressure" in result.reason
    assert "muscle" in result.reason


def test_a_command_that_the_firmware_refuses_ends_the_run(runs: Path, tmp_path: Path) -> None:
    text = scenario_text("held-steps").replace("setpoint_kpa = 350", "setpoint_kpa = 700")
    result = simulate(load_scenario(written(tmp_path, text)), runs, derive=False)
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
            "no inertia",
        ),
        ("rest_mm = 62.0", "rest_mm = 95.0", "outside the braid"),
        ("rest_mm = 62.0", "rest_mm = 82.0", "outside the braid"),
        ('name = "elbow"', 'name = "wrist"', "unknown joint 'wrist'"),
        ("duration_s = 4.0", "duration_s = -1", "duration_s"),
        ("seed = 1", "sed = 1", "unknown key"),
        ('scheme = "burst"', 'scheme = "brst"', "scheme"),
        ('muscle = "flexor"', 'muscle = "flexo"', "no muscle is called 'flexo'"),
        ("setpoint_kpa = 320", "setpoint_kpa = 320\nscheme = 'two'", "one of scheme"),
        ("at_s = 3.2\nseconds", "at_s = 3.9\nseconds", "window ends after"),
        ('kind = "joint"', 'kind = "jiont"', "load.kind"),
        ("radius_mm = 8.0", "radius_mm = 8.0\nmodel = 'chou'", "model"),
        ("start_deg = 0.0", "start_deg = 80.0", "start_deg"),
        ("seed = 1", "seed = 1\n[plant]\nsupply_kpa = 9000\n", "supply_kpa"),
        ("seed = 1", "seed = 1\n[effects.leek]\nx = 1\n", "leek"),
        ("rest_mm = 62.0", "rest_mm = 62.0\nparameters = { two_ded = 5 }", "two_ded"),
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
        return subprocess.run(
            [sys.executable, "-m", "rigs.cli", "simulate", *words, "--out", str(tmp_path / "runs")],
            capture_output=True, text=True, timeout=300, check=False,
        )  # fmt: skip

    bad = written(tmp_path, scenario_text().replace("mass_g = 200.0", "mass_g = -200.0"))
    done = pamrig_command(bad)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "mine.toml" in done.stderr
    assert not (tmp_path / "runs").exists()
    done = pamrig_command("held-steps", "--json")
    assert done.returncode == 0
    assert json.loads(done.stdout)["outcome"] == "clean"
