"""The prediction beside the measurement: right where the plant is, apart where it is not."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from analysis.layouts.layouts import isometric_layout
from bench_runs import quick, run_isometric
from daq.errors import ConfigError
from daq.live.scene import Scene
from daq.live.viewfile import build_view
from daq.store.run import open_run
from daq.store.verify import verify
from plant.constants import PlantConstants
from plant.effects.effects import NONE, Effects
from rigs.execution.runner import Runner
from rigs.live.prediction import FORCE_PATH, PRESSURE_PATH, SHARE_PATHS, LivePrediction
from rigs.rigfile.config import load_rig
from rigs.rigfile.plant_file import load_plant


class Sheet:
    """Keeps what is drawn."""

    def __init__(self) -> None:
        self.curves: dict[str, list[tuple[float, float]]] = {}
        self.words: list[str] = []

    def series(self, path: str, time_s: Any, values: Any) -> None:
        self.curves.setdefault(path, []).extend(zip(time_s, values, strict=True))

    def text(self, time_s: float, text: str, level: str) -> None:
        del time_s, level
        self.words.append(text)


def watched(
    folder: Path, constants: PlantConstants, effects: Effects = NONE
) -> tuple[Sheet, dict[str, Any]]:
    """A short test with a prediction attached; what was drawn and what was measured."""
    config = load_rig("virtual")
    sheet = Sheet()

    def begin(runner: Runner, record: Any) -> None:
        LivePrediction(sheet, constants, effects).attach(runner.rig, record, runner.watch)

    result = run_isometric(config, quick(config), folder, on_start=begin, derive=True)
    return sheet, {"table": open_run(result.folder).table, "folder": result.folder}


def plant() -> PlantConstants:
    import dataclasses

    from plant.constants import nominal

    config = load_rig("virtual")
    assert config.virtual is not None
    return dataclasses.replace(nominal().with_overrides(config.virtual.plant))


def measured(folder: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    from daq.store.derive import engineering

    run = open_run(folder)
    valve, _ = engineering(run, "valve")
    balance, _ = engineering(run, "balance")
    return valve["time_s"], valve["pressure_kpa"], balance["time_s"], balance["force_n"]


def test_on_the_bench_s_own_plant_prediction_and_measurement_lie_together(tmp_path: Path) -> None:
    sheet, what = watched(tmp_path, plant())
    time_s, pressure, when_s, force = measured(what["folder"])
    told = np.array(sheet.curves[PRESSURE_PATH])
    seen = np.interp(told[:, 0], time_s, pressure)
    assert np.sqrt(np.mean((told[:, 1] - seen) ** 2)) < 5.0
    pulled = np.array(sheet.curves[FORCE_PATH])
    tared = when_s > when_s[-1] - 8.0  # after the last tare
    here = (pulled[:, 0] > when_s[tared][0]) & (pulled[:, 0] < when_s[-1])
    read = np.interp(pulled[here, 0], when_s, force)
    high = read > 5.0
    assert high.sum() > 20
    assert np.median(np.abs(pulled[here, 1] - read)[high]) < 0.3
    assert not sheet.words


def test_what_was_drawn_is_recorded_and_drawn_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sheet, what = watched(tmp_path, plant())
    run = open_run(what["folder"])
    assert verify(run) == []
    again: dict[str, list[tuple[float, float]]] = {}

    def series(self: Scene, path: str, time_s: Any, values: Any) -> None:
        again.setdefault(path, []).extend(zip(time_s, values, strict=True))

    monkeypatch.setattr(Scene, "series", series)
    build_view(run, tmp_path / "view.rrd", isometric_layout())
    for path in (PRESSURE_PATH, FORCE_PATH, *SHARE_PATHS):
        drawn, replayed = np.array(sheet.curves[path]), np.array(again[path])
        assert 0 <= len(drawn) - len(replayed) <= 10, "but for the last frames after the test"
        assert np.allclose(replayed, drawn[: len(replayed)], atol=1e-6)


def test_an_effect_that_the_plant_has_and_the_bench_has_not_shows(tmp_path: Path) -> None:
    liner = Effects.from_config({"liner_threshold": {"threshold_kpa": 100.0}})
    sheet, what = watched(tmp_path, plant(), liner)
    top = what["table"]["force_n"].max()
    assert max(value for _, value in sheet.curves[FORCE_PATH]) < 0.9 * top


def test_a_prediction_that_fails_says_so_once_and_the_test_goes_on(tmp_path: Path) -> None:
    # Its braid is shorter than the muscle will be held.
    short = {"length_min_mm": 50.0, "length_max_mm": 60.0, "braid_length_mm": 62.0}
    broken = plant().with_overrides(short)
    sheet, what = watched(tmp_path, broken)
    assert len(what["table"]) == 16
    assert len(sheet.words) == 1
    assert "prediction stopped" in sheet.words[0]


def test_a_plant_file_or_a_rig_file_is_read_and_a_bad_one_refused(tmp_path: Path) -> None:
    good = tmp_path / "plant.toml"
    good.write_text("supply_kpa = 640\n[effects.creep]\nrelaxation_percent = 4\n")
    constants, effects = load_plant(good)
    assert constants.supply_pa == 640e3
    assert "creep" in effects
    rig = tmp_path / "rig.toml"
    rig.write_text(load_rig("virtual").text)
    assert load_plant(rig)[0].supply_pa == 700e3
    bad = tmp_path / "bad.toml"
    bad.write_text("suply_kpa = 640\n")
    with pytest.raises(ConfigError, match="did you mean supply_kpa"):
        load_plant(bad)


# ---------------------------------------------------------------------------- shares by stage


def test_shares_add_up_and_go_to_the_stage_that_is_wrong() -> None:
    from rigs.live.stage_share import LiveShare

    for gas_n, muscle_n, most in ((4.0, 0.5, 0), (0.5, 4.0, 1)):
        share = LiveShare()
        time_s = np.arange(0.0, 5.0, 0.1)
        for t in time_s:
            share.predicted(float(t), 50.0, 50.0 - gas_n)
        share.measured(time_s[1:-1], np.full(len(time_s) - 2, 50.0 + muscle_n))
        found = share.shares
        assert found is not None
        assert sum(found) == pytest.approx(1.0)
        assert found[most] > 0.8
        # Exact Shapley of two stages: own square and half of what they have in common.
        whole = (gas_n + muscle_n) ** 2
        assert found[0] == pytest.approx((gas_n**2 + gas_n * muscle_n) / whole)


def test_without_a_gap_no_share_is_said() -> None:
    from rigs.live.stage_share import LiveShare

    share = LiveShare()
    assert share.shares is None
    for t in (0.0, 1.0, 2.0):
        share.predicted(t, 50.0, 50.0)
    share.measured(np.array([0.5, 1.5]), np.array([50.05, 49.95]))
    assert share.shares is None


def test_a_muscle_that_the_plant_does_not_know_shows_in_the_live_share(tmp_path: Path) -> None:
    liner = Effects.from_config({"liner_threshold": {"threshold_kpa": 100.0}})
    sheet, _ = watched(tmp_path, plant(), liner)
    gas, muscle = (np.array(sheet.curves[path]) for path in SHARE_PATHS)
    assert len(muscle) > 10
    assert muscle[-1, 1] > 80.0
    assert np.allclose(gas[:, 1] + muscle[:, 1], 100.0)
