"""A simulator from elsewhere takes the place of the nominal plant in the diagnosis.

With the plant's own equation, constants and tolerances, each binding leads to the verdict that the
built-in plant leads to.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

import pamrig
from gap.data.dataset import DataSet
from gap.data.reader import read_dataset
from gap.decision.diagnose import diagnose
from gap.simulators.open import open_simulator, with_simulator
from gap.verdict import Verdict
from gap_sets import settled_set
from plant.constants import nominal
from simulator_files import FMU, FORCE, STATIC, built_fmu, chou_hannaford, write

PLANT = nominal()
BRAID_MM, TURNS = PLANT.braid_length_m * 1e3, PLANT.turns
BRAID_SD_MM, TURNS_SD = PLANT.tolerance_si("braid_length_mm") * 1e3, PLANT.tolerance_si("turns")
EFFECTS = {"force_zero": {"offset_n": 2.0}}


def of_the_plant(text: str) -> str:
    """A description with the plant's numbers in the place of the example's."""
    text = text.replace("nominal = 85.0\ntolerance = 0.3",
                        f"nominal = {BRAID_MM!r}\ntolerance = {BRAID_SD_MM!r}")  # fmt: skip
    return text.replace("nominal = 1.75\ntolerance = 0.01",
                        f"nominal = {TURNS!r}\ntolerance = {TURNS_SD!r}")  # fmt: skip


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> DataSet:
    """Settled points of the plant whose force is read 2 N too high."""
    return read_dataset(settled_set(tmp_path_factory.mktemp("zero") / "data", EFFECTS))


@pytest.fixture(scope="module")
def built_in(data: DataSet) -> Verdict:
    return diagnose(data)


def predicted(folder: Path, data: DataSet) -> Path:
    """What the plant predicts, and what it predicts one tolerance away, as three tables each."""
    folder.mkdir(parents=True, exist_ok=True)
    values = {"mid": (BRAID_MM, TURNS)}
    for name, sign in (("high", 1.0), ("low", -1.0)):
        values[f"braid_{name}"] = (BRAID_MM + sign * BRAID_SD_MM, TURNS)
        values[f"turns_{name}"] = (BRAID_MM, TURNS + sign * TURNS_SD)
    for name, (braid, turns) in values.items():
        frames = []
        for trial in data.trials:
            p = trial["pressure_kpa"].value
            length = 0.0 * p + trial.held_length_mm
            force = chou_hannaford(p, length, braid, turns)
            frames.append(pd.DataFrame({"trial": trial.name, "force_n": force}))
        pd.concat(frames).to_csv(folder / f"{name}.csv", index=False)
    text = 'kind = "predictions"\ntable = "mid.csv"\nstages = ["force"]\n'
    for name, value, sd in (("braid", BRAID_MM, BRAID_SD_MM), ("turns", TURNS, TURNS_SD)):
        text += f"[parameters.{name}]\nnominal = {value!r}\ntolerance = {sd!r}\n"
        text += f'table_high = "{name}_high.csv"\ntable_low = "{name}_low.csv"\n'
    return write(folder, simulator_toml=text)


@pytest.fixture(params=["python", "fmi 2", "fmi 3", "predictions"])
def plant_from_elsewhere(request: pytest.FixtureRequest, tmp_path: Path, data: DataSet) -> Path:
    if request.param == "python":
        return write(tmp_path, simulator_toml=of_the_plant(STATIC), muscle_py=FORCE)
    if request.param == "predictions":
        return predicted(tmp_path, data)
    built_fmu(tmp_path, int(request.param[-1]))
    text = FMU.replace("stages", "static = true\nstages", 1)
    return write(tmp_path, simulator_toml=of_the_plant(text))


def test_each_binding_leads_to_the_verdict_of_the_built_in_plant(
    plant_from_elsewhere: Path, data: DataSet, built_in: Verdict
) -> None:
    found = diagnose(with_simulator(data, plant_from_elsewhere))
    assert built_in.effects[0].ids == ("force_zero",)
    assert found.status == built_in.status
    assert found.stage == built_in.stage
    assert found.effects[0].ids == built_in.effects[0].ids
    assert found.gap is not None
    assert built_in.gap is not None
    assert found.gap.before == pytest.approx(built_in.gap.before, rel=1e-6)
    assert found.gap.after == pytest.approx(built_in.gap.after, rel=0.02)
    offset = found.effects[0].parameters["offset_n"]
    expected = built_in.effects[0].parameters["offset_n"]
    assert offset.value == pytest.approx(expected.value, abs=0.02)
    assert offset.low < 2.0 < offset.high


@pytest.mark.parametrize(
    "kind", ["python", pytest.param("predictions", marks=pytest.mark.campaign)]
)
@pytest.mark.parametrize("command", ["diagnose", "where", "shrink", "next", "report"])
def test_every_command_takes_a_simulator(
    command: str, kind: str, data: DataSet, built_in: Verdict, tmp_path: Path
) -> None:
    if kind == "predictions":
        described = predicted(tmp_path, data)
    else:
        described = write(tmp_path, simulator_toml=of_the_plant(STATIC), muscle_py=FORCE)
    out = [] if command == "diagnose" else ["--out", str(tmp_path / f"out.{ENDINGS[command]}")]
    ran = subprocess.run(
        [sys.executable, "-m", "cli.main", "gap", command, data.origin, "--json", *out,
         "--simulator", str(described)],
        capture_output=True, text=True, timeout=300, cwd=tmp_path, check=False,
    )  # fmt: skip
    assert ran.returncode == 0, ran.stderr
    made = json.loads(ran.stdout)
    assert made.get("status", built_in.status) == built_in.status
    assert "Traceback" not in ran.stderr


ENDINGS = {"where": "png", "shrink": "toml", "next": "toml", "report": "html"}


def test_in_python_a_simulator_is_a_path_or_an_object(tmp_path: Path, data: DataSet) -> None:
    path = write(tmp_path, simulator_toml=of_the_plant(STATIC), muscle_py=FORCE)
    by_path = pamrig.diagnose(data.origin, simulator=path)
    by_object = pamrig.diagnose(data.origin, simulator=open_simulator(path))
    assert by_path.as_dict() == by_object.as_dict()
    assert by_path.effects[0].ids == ("force_zero",)


def test_an_effect_that_the_simulator_is_stated_to_have_is_no_gap(
    tmp_path: Path, data: DataSet
) -> None:
    text = of_the_plant(STATIC) + "\n[effects.force_zero]\noffset_n = 2.0\n"
    path = write(tmp_path, simulator_toml=text, muscle_py=FORCE)
    assert diagnose(with_simulator(data, path)).status == "no_gap_above_floor"
