"""What a regulator's calibration is used for: the live prediction and the diagnosis."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from analysis.regression.regulator import Regulator
from bench_runs import quick, run_isometric
from daq.store.derive import VALVE_STREAM, engineering
from daq.store.run import Run, open_run
from gap.data.from_runs import export_runs
from gap.data.reader import read_dataset
from gap.data.regulator import regulator_notes
from gap.decision.diagnose import diagnose
from plant.constants import nominal
from rigs.execution.session import run_protocol
from rigs.live.prediction import PRESSURE_PATH, LivePrediction
from rigs.protocols.registry import procedure
from rigs.rigfile.config import RigConfig, load_rig
from rigs.rigfile.tables.regulator import write_dynamics
from rigs.rigfile.toml_reader import find_config

BAD: dict[str, float] = {
    "dead_time_s": 0.08, "time_constant_s": 0.4, "slew_kpa_s": 300.0, "dead_band_kpa": 2.5,
    "hysteresis_kpa": 5.0, "offset_kpa": 2.0, "gain_error": 0.005,
}  # fmt: skip
"""A slow regulator with all the faults that one may have, at the ends of their ranges."""
U = {"offset_kpa": 0.3, "gain_error": 0.003, "hysteresis_kpa": 0.1}


def rig(tmp_path: Path, known: dict[str, float] | None, effects: str = "") -> RigConfig:
    text = load_rig("virtual-alicat").text + "\n[virtual.regulator]\n"
    text += "".join(f"{name} = {value}\n" for name, value in BAD.items()) + effects
    if known is not None:
        write_dynamics(tmp_path / "regulator.toml", Regulator(**known), U, {}, True)
        text = text.replace("# dynamics =", "dynamics =")
    (tmp_path / "rig.toml").write_text(text)
    return load_rig(str(tmp_path / "rig.toml"))


class Sheet:
    """A live view that keeps what it is given."""

    def __init__(self) -> None:
        self.rows: list[tuple[float, float]] = []
        self.words: list[str] = []

    def series(self, path: str, time_s: Any, values: Any) -> None:
        if path == PRESSURE_PATH:
            self.rows += zip(time_s, values, strict=True)

    def text(self, time_s: float, text: str, level: str) -> None:
        self.words.append(text)


@pytest.fixture(scope="module")
def predicted(tmp_path_factory: pytest.TempPathFactory) -> tuple[Sheet, Run]:
    folder = tmp_path_factory.mktemp("regulator")
    config, sheet = rig(folder, BAD), Sheet()
    plan = quick(config, lengths_mm=(60.0,), pressures_kpa=(200.0, 500.0), order="up-down")

    def start(runner: Any, record: Any) -> None:
        LivePrediction(sheet, nominal()).attach(runner.rig, record, runner.watch)

    result = run_isometric(config, plan, folder / "runs", derive=False, on_start=start)
    assert result.outcome == "clean", result.error
    return sheet, open_run(result.folder)


def test_the_live_view_draws_the_pressure_that_the_regulator_makes(
    predicted: tuple[Sheet, Run],
) -> None:
    sheet, run = predicted
    assert sheet.words == []
    columns, _ = engineering(run, VALVE_STREAM)
    at_s, drawn = np.array(sheet.rows).T
    measured = np.interp(at_s, columns["time_s"], columns["pressure_kpa"])
    high = drawn > 150.0
    assert high.sum() > 200  # one for each frame of ten samples
    apart = np.abs(measured - drawn)[high]
    assert np.median(apart) < 3.0  # the transducer's own error, 2 u at 500 kPa
    assert np.quantile(apart, 0.9) < 40.0  # on its way it moves by 300 kPa/s


def test_the_diagnosis_says_what_the_regulator_explains(predicted: tuple[Sheet, Run]) -> None:
    _, run = predicted
    (note,) = regulator_notes(run)
    assert note.endswith("regulator, not muscle")
    assert "leaves" in note


def test_an_exported_data_set_keeps_the_note(predicted: tuple[Sheet, Run], tmp_path: Path) -> None:
    _, run = predicted
    (note,) = regulator_notes(run)
    export_runs([run], tmp_path / "set")
    trials = pd.read_csv(tmp_path / "set" / "trials.csv")
    assert set(trials["note"]) == {note}


def test_a_regulator_that_is_not_as_calibrated_is_said(
    predicted: tuple[Sheet, Run], monkeypatch: pytest.MonkeyPatch
) -> None:
    _, run = predicted
    other = {**run.manifest["regulator"], "offset_kpa": -20.0}
    monkeypatch.setitem(run.manifest, "regulator", other)
    (note,) = regulator_notes(run)
    assert note.endswith("is not as it was calibrated")


def test_a_run_without_such_a_calibration_has_no_note(
    predicted: tuple[Sheet, Run], monkeypatch: pytest.MonkeyPatch
) -> None:
    _, run = predicted
    monkeypatch.delitem(run.manifest, "regulator")
    assert regulator_notes(run) == ()


@pytest.mark.campaign
@pytest.mark.parametrize(
    ("effects", "named"),
    [("", []), ("\n[effects.braid_friction]\nfriction_n = 2.0\n", [("braid_friction",)])],
)
def test_the_muscle_is_not_blamed_for_its_regulator(
    effects: str, named: list[tuple[str, ...]], tmp_path: Path
) -> None:
    """Isometric and hysteresis tests with the worst regulator, with and without friction."""
    config = rig(tmp_path, BAD, effects)
    runs = []
    for name in ("isometric", "hysteresis"):
        head, mark, tail = find_config(f"{name}-short", "protocols")[0].partition("repeats = 1")
        assert mark
        (tmp_path / f"{name}.toml").write_text(f"{head}repeats = 4{tail}")
        chosen = procedure(name)
        plan = chosen.read(str(tmp_path / f"{name}.toml"), config)
        result = run_protocol(chosen, config, plan, tmp_path / "runs")
        assert result.outcome == "clean", result.error
        runs.append(open_run(result.folder))
    export_runs(runs, tmp_path / "data")
    verdict = diagnose(read_dataset(tmp_path / "data"))
    assert [effect.ids for effect in verdict.effects] == named, verdict
