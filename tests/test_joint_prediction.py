"""What the plant predicts of a joint, beside what is measured: `--predict` for tests of a joint."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from analysis.run_table import reduce_run
from daq.errors import ConfigError
from joint_bench import joint_plan, joint_rig, run_joint
from plant.constants import nominal
from plant.effects.effects import NONE
from rigs.execution.runner import Runner
from rigs.live.joint_prediction import (
    ANGLE_PATH,
    TORQUE_PATH,
    JointPrediction,
    joint_of_file,
    predicting_joint,
)
from rigs.rigfile.config import RigConfig, load_rig
from rigs.virtual.board.joint_load import read_joint_constants

QUICK: dict[str, Any] = {
    "common_kpa": (200.0,), "difference_kpa": (-80.0, 80.0), "angles_deg": (-10.0,),
    "method": dataclasses.replace(
        joint_plan("joint-static", joint_rig()).method, precondition_cycles=0
    ),
}  # fmt: skip


class View:
    """Takes curves and words."""

    def __init__(self) -> None:
        self.curves: dict[str, list[tuple[float, float]]] = {}
        self.words: list[str] = []

    def series(self, path: str, time_s: Any, values: Any) -> None:
        self.curves.setdefault(path, []).extend(zip(time_s, values, strict=True))

    def text(self, time_s: float, text: str, level: str) -> None:
        self.words.append(text)

    def mean(self, path: str, begin_s: float, end_s: float) -> float:
        at, values = np.array(self.curves[path]).T
        inside = (at >= begin_s) & (at <= end_s)
        return float(values[inside].mean())


def predicted(config: RigConfig, folder: Path, **virtual: Any) -> tuple[Any, View]:
    """A run, and what the plant that made it predicts of it."""
    view = View()
    assert config.virtual is not None
    constants = nominal().with_overrides(config.virtual.plant)
    joint = read_joint_constants({**config.virtual.joint, **virtual}, config.source)

    def begin(runner: Runner) -> None:
        made = JointPrediction(view, constants, NONE, joint)
        made.attach(runner.rig, runner.record, runner.watch)

    result, run, _ = run_joint("joint-static", folder, config, begin=begin, **QUICK)
    assert result.outcome == "clean", result.error
    return run, view


def test_angle_and_torque_are_predicted_from_the_measured_pressures(tmp_path: Path) -> None:
    config = joint_rig()
    run, view = predicted(config, tmp_path)
    assert view.words == []
    table = reduce_run(run).table
    stream = run.samples("encoder")
    begin_ns = run.manifest["started"]["monotonic_ns"]
    points = [e for e in run.events if e["kind"] == "point"]
    for row, event in zip(table.to_dict("records"), points, strict=True):
        first, end = event["encoder_rows"]
        here = stream["host_ns"][(stream["row"] >= first) & (stream["row"] < end)]
        begin_s, end_s = (here[[0, -1]] - float(begin_ns)) * 1e-9
        if row["state"] == "free":
            found = view.mean(ANGLE_PATH, begin_s, end_s)
            assert found == pytest.approx(row["angle_deg"], abs=0.4)
            assert abs(found) > 10.0
        else:
            found = view.mean(TORQUE_PATH, begin_s, end_s)
            assert found == pytest.approx(row["torque_n_m"], abs=0.004)
            assert abs(found) > 0.01


def test_another_lever_arm_predicts_another_torque(tmp_path: Path) -> None:
    """It is computed, not copied from what is measured."""
    run, view = predicted(joint_rig(), tmp_path, radius_mm=6.0)
    table = reduce_run(run).table
    locked = table[table["state"] == "locked"]["torque_n_m"].abs().max()
    at, torque = np.array(view.curves[TORQUE_PATH]).T
    del at
    assert np.abs(torque).max() < 0.95 * locked


def test_the_joint_comes_from_the_file_or_from_the_rig(tmp_path: Path) -> None:
    config = load_rig("virtual-joint")
    stated = tmp_path / "stated.toml"
    stated.write_text("[virtual.joint]\nradius_mm = 9.0\n")
    plain = tmp_path / "plant.toml"
    plain.write_text("supply_kpa = 700\n")
    assert joint_of_file(stated, config).radius_m == pytest.approx(9e-3)
    assert joint_of_file(plain, config).radius_m == pytest.approx(8e-3)
    bare = dataclasses.replace(config, virtual=None)
    with pytest.raises(ConfigError, match=r"no table \[virtual\.joint\]"):
        joint_of_file(plain, bare)
    wrong = tmp_path / "wrong.toml"
    wrong.write_text("[virtual.joint]\nradius = 9.0\n")
    with pytest.raises(ConfigError, match=r"virtual\.joint\.radius"):
        predicting_joint(wrong, config, [], lambda runner, record: None)
