"""Runs on the virtual joint, and what its own statics say, by another way than the reduction."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

from scipy.optimize import brentq

from daq.clock import VirtualClock
from daq.store.run import Run, open_run
from plant.constants import nominal
from plant.simulator.bench import BenchSim
from rigs.execution.runner import Runner
from rigs.execution.session import Result, run_protocol
from rigs.protocols.registry import procedure
from rigs.rigfile.config import RigConfig, load_rig
from rigs.virtual.bench import VirtualBench

HAND_S = 0.2
"""A person who is quicker than any: the lock takes no bench time worth simulating."""


def joint_rig(seed: int | None = None, rig: str = "virtual-joint", **joint: Any) -> RigConfig:
    """A shipped rig; ``joint`` changes keys of [virtual.joint]."""
    config = load_rig(rig, seed)
    assert config.virtual is not None
    virtual = dataclasses.replace(config.virtual, joint={**config.virtual.joint, **joint})
    return dataclasses.replace(config, virtual=virtual)


def joint_plan(name: str, config: RigConfig, **changes: Any) -> Any:
    """The short test of a joint, with some of it changed."""
    return dataclasses.replace(procedure(name).read(f"{name}-short", config), **changes)


def run_joint(
    name: str,
    root: Path,
    config: RigConfig | None = None,
    begin: Callable[[Runner], None] | None = None,
    how: dict[str, Any] | None = None,
    **changes: Any,
) -> tuple[Result, Run, VirtualBench]:
    """Run a short test of a joint; the bench stays to be asked for truths."""
    config = config or joint_rig()
    bench = VirtualBench(config, VirtualClock())

    def start(runner: Runner, record: object) -> None:
        del record
        if begin is not None:
            begin(runner)

    result = run_protocol(
        procedure(name), config, joint_plan(name, config, **changes), root, bench=bench,
        person=bench.extras.operator(seconds=HAND_S), on_start=start, **(how or {}),
    )  # fmt: skip
    return result, open_run(result.folder), bench


class Statics:
    """The joint at rest: forces of a single simulated muscle, and a solved balance of torques."""

    def __init__(self, config: RigConfig) -> None:
        assert config.virtual is not None
        self._muscle = BenchSim(nominal().with_overrides(config.virtual.plant))
        self._radius_m = float(config.virtual.joint.get("radius_mm", 8.0)) * 1e-3
        self._rest_mm = float(config.virtual.joint.get("rest_mm", 62.0))

    def pull_n(self, pressure_kpa: float, length_mm: float) -> float:
        """Pull of one muscle."""
        self._muscle.set_pressure(0.0)
        self._muscle.set_length(length_mm)
        self._muscle.set_pressure(pressure_kpa)
        return max(0.0, self._muscle.force_n)

    def torque_n_m(self, a_kpa: float, b_kpa: float, angle_deg: float) -> float:
        """What the muscles exert at an angle, positive towards larger ones."""
        turned_mm = self._radius_m * 1e3 * math.radians(angle_deg)
        pull = self.pull_n(a_kpa, self._rest_mm - turned_mm)
        return self._radius_m * (pull - self.pull_n(b_kpa, self._rest_mm + turned_mm))

    def angle_deg(self, a_kpa: float, b_kpa: float, load_n_m: float = 0.0) -> float:
        """Where the joint is at rest under a load."""
        return float(
            brentq(lambda q: self.torque_n_m(a_kpa, b_kpa, q) + load_n_m, -45, 45, xtol=1e-9)
        )

    def stiffness_n_m_rad(self, a_kpa: float, b_kpa: float, angle_deg: float) -> float:
        """By two loads that hold the joint a little to either side of an angle."""
        load, change = -self.torque_n_m(a_kpa, b_kpa, angle_deg), 1e-4
        ends = [self.angle_deg(a_kpa, b_kpa, load + way * change) for way in (-1.0, 1.0)]
        return 2.0 * change / math.radians(ends[1] - ends[0])
