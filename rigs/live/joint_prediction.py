"""What the plant predicts of a joint while a test runs, drawn beside what is measured.

Both pressures are the measured ones; the motion of the arm between the muscles is that of
`plant.links`. Of a free joint the angle is predicted, of a locked one the torque on its lock. A
prediction that fails says so once and is silent from then on.
"""

from __future__ import annotations

import contextlib
import tomllib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from daq.clock import NS_PER_S
from daq.errors import ConfigError
from daq.record.writer import RecordWriter
from plant import tomlfile
from plant.constants import PlantConstants
from plant.effects.effects import Effects
from plant.physics.layout import PRESSURE
from rigs.bench.rig import Rig
from rigs.execution.runner import Runner, Watch
from rigs.live.prediction import TICK_S, Batch, Drawn
from rigs.rigfile.config import RigConfig
from rigs.rigfile.plant_file import load_plant
from rigs.virtual.board.joint_load import JointConstants, JointLoad, read_joint_constants

if TYPE_CHECKING:
    from rigs.live.feed import LiveFeed

ANGLE_PATH = "angle/predicted_deg"
TORQUE_PATH = "torque/predicted"
LEAST_PA = -50e3
RECENT = 3
"""Readings of the angle whose mean is that of a lock that was just set."""


class JointPrediction:
    """Follows a test of a joint and draws what the plant says.

    Args:
        view: where it is drawn.
        constants, effects: of both muscles.
        joint: the arm between them.
    """

    def __init__(
        self, view: Drawn, constants: PlantConstants, effects: Effects, joint: JointConstants
    ) -> None:
        self.view = view
        # Its own ways out are shut: pressures only ever go where the measured ones are.
        shut = constants.with_overrides({"outlet_normally": "closed"})
        self._plant = JointLoad(shut, effects, joint, "valve")
        self._locked = self._failed = False
        self._b_pa = 0.0
        self._off = np.zeros(2)

    def attach(self, rig: Rig, record: RecordWriter, watch: Watch) -> None:
        """Listen to both controllers and to what is done with the lock, before the run."""
        joint, second = rig.config.joint, rig.second
        assert joint is not None
        assert second is not None
        self._start_ns = record.start_ns
        self._per_n_m = 1e3 / joint.lever_mm if joint.lever_mm else 1.0
        self._calibrations = [side.config.calibrations["pressure_kpa"] for side in rig.sides]
        angle = rig.instruments[joint.angle]

        def locked(on: bool) -> None:
            self._locked = on
            if on:
                self._plant.lock(angle.mean(RECENT))
            else:
                self._plant.release()

        watch.locked = locked
        second.valve.on_batch.append(self._second)
        rig.valve.on_batch.append(self._batch)

    def _second(self, batch: Batch) -> None:
        """Newest pressures of muscle b."""
        kpa = self._calibrations[1].apply(batch["counts"].astype(np.float64))
        self._b_pa = max(float(np.mean(kpa)) * 1e3, LEAST_PA)

    def _batch(self, batch: Batch) -> None:
        if self._failed:
            return
        try:
            self._follow(batch)
        except Exception as error:
            self._failed = True
            with contextlib.suppress(Exception):
                self.view.text(0.0, f"prediction stopped: {error}", "WARN")

    def _follow(self, batch: Batch) -> None:
        pressures = self._calibrations[0].apply(batch["counts"].astype(np.float64)) * 1e3
        plant, units = self._plant, self._plant.scene.world.units
        for pressure in np.maximum(pressures, LEAST_PA):
            units[0, PRESSURE], units[1, PRESSURE] = pressure, self._b_pa
            plant.scene.advance(TICK_S, self._off, self._off)
        time_s = (float(batch["host_ns"][-1]) - self._start_ns) / NS_PER_S
        if self._locked:
            torque = plant.lock_torque_n_m * self._per_n_m
            self.view.series(TORQUE_PATH, [time_s], [torque])
        else:
            self.view.series(ANGLE_PATH, [time_s], [plant.angle_deg])


def joint_of_file(path: Path, config: RigConfig) -> JointConstants:
    """The joint that is predicted: of the file, else of the rig itself.

    Raises:
        ConfigError: neither has a table ``[virtual.joint]``.
    """
    try:
        table: dict[str, Any] = tomlfile.loads(tomlfile.read_text(path))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigError(str(path), f"cannot be read as TOML ({error})") from None
    virtual = table.get("virtual")
    stated = virtual.get("joint") if isinstance(virtual, dict) else None
    if isinstance(stated, dict):
        return read_joint_constants(stated, str(path))
    if config.virtual is not None and config.virtual.joint:
        return read_joint_constants(config.virtual.joint, config.source)
    raise ConfigError(
        str(path), "has no table [virtual.joint] with the arm between the muscles",
        "give a rig file that has one, see configs/rigs/virtual-joint.toml",
    )  # fmt: skip


def predicting_joint(
    path: Path,
    config: RigConfig,
    feeds: Sequence[LiveFeed],
    begin: Callable[[Runner, RecordWriter], None],
) -> Callable[[Runner, RecordWriter], None]:
    """As `rigs.live.prediction.predicting`, for a rig with a joint.

    Raises:
        ConfigError: see `rigs.rigfile.plant_file.load_plant` and `joint_of_file`.
    """
    constants, effects = load_plant(path)
    joint = joint_of_file(path, config)

    def start(runner: Runner, record: RecordWriter) -> None:
        begin(runner, record)
        for feed in feeds:
            prediction = JointPrediction(feed.view, constants, effects, joint)
            prediction.attach(runner.rig, record, runner.watch)

    return start
