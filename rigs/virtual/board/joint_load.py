"""Two muscles on one joint, in the place of the virtual bench's one muscle.

The joint is an arm of `plant.links` with one link, or, where it has dry friction, one coordinate
with the inertia of that arm: dry friction is known for those only. A lock holds the joint at an
angle with a torsion spring, whose torque is what a torque sensor in the lock reads.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from daq.errors import ConfigError
from plant.arrays import Array
from plant.constants import PlantConstants
from plant.effects.effects import Effects
from plant.errors import LinkError
from plant.links.arm import Arm
from plant.links.reader import load_arm
from plant.scene import layout as sc
from plant.scene.scene import (
    JOINT_STOP_N_M_RAD,
    JOINT_STOP_N_M_S_RAD,
    Coordinate,
    Scene,
    Unit,
)
from plant.simulator.bench import BenchSim, Source
from rigs.rigfile.toml_reader import Table
from rigs.virtual.board.board import TICK_S, SimBoard
from rigs.virtual.board.scene_loop import SceneBoard
from valvefw.wire import TICK_US

LOCK_DAMPING = 0.7
"""Of the locked joint, as a share of the critical damping."""


def _inertia(arm: Arm) -> float:
    """Moment of inertia of a joint, in kg m^2."""
    from plant.links.dynamics import inertia_matrix  # compiles; only a bench with a joint needs it

    return float(inertia_matrix(arm, np.zeros(1))[0, 0])


@dataclass(frozen=True)
class JointConstants:
    """The table ``[virtual.joint]``, in SI.

    Attributes:
        arm: one link; its joint is the one that turns.
        radius_m: lever arm of both muscles.
        rest_m: length of either muscle at angle 0.
        friction_n_m: dry friction of the joint.
        lock_n_m_rad: stiffness of the lock with its torque sensor.
    """

    arm: Arm
    radius_m: float = 8e-3
    rest_m: float = 62e-3
    friction_n_m: float = 0.0
    lock_n_m_rad: float = 200.0


def read_joint_constants(values: Mapping[str, Any], source: str) -> JointConstants:
    """The table ``[virtual.joint]`` of a rig file.

    Raises:
        ConfigError: names file and key.
    """
    t = Table(dict(values), source, "virtual.joint")
    given = t.raw("arm", "forearm")
    payload = t.number("payload_g", 0, 1e5, 0.0, unit="g") * 1e-3
    try:
        arm = load_arm(given if isinstance(given, dict) else str(given)).with_payload(payload)
    except LinkError as error:
        raise ConfigError(f"{source}: virtual.joint.arm", str(error)) from None
    out = JointConstants(
        arm,
        radius_m=t.number("radius_mm", 0.1, 1000, 8.0, unit="mm") * 1e-3,
        rest_m=t.number("rest_mm", 1, 2000, 62.0, unit="mm") * 1e-3,
        friction_n_m=t.number("friction_n_m", 0, 1e3, 0.0, unit="N m"),
        lock_n_m_rad=t.number("lock_n_m_rad", 1, 1e4, 200.0, unit="N m/rad"),
    )
    t.finish()
    if arm.degrees != 1 or not math.isfinite(arm.links[0].low_rad):
        raise t.fail("arm", "needs exactly one link, with range_deg", "see configs/plant/links")
    if out.friction_n_m and any(arm.gravity):
        raise t.fail(
            "friction_n_m", "dry friction is simulated in a level plane only", "set gravity to 0"
        )
    return out


class JointLoad(BenchSim):
    """Two muscles on a joint; as a bench with one muscle it shows muscle a.

    Attributes:
        scene: both muscles, units ``a`` and ``b``, and the joint. Its arrays are what the boards
            step.
        joint: the constants.
    """

    def __init__(
        self, constants: PlantConstants, effects: Effects, joint: JointConstants, source: Source
    ) -> None:
        super().__init__(constants, effects, source=source, length_m=joint.rest_m)
        self.joint = joint
        link = joint.arm.links[0]
        name = link.joint
        units = [
            Unit(
                which, constants, effects, source=source,
                reach={name: way * joint.radius_m}, rest_m=joint.rest_m, tendon=True,
            )
            for which, way in (("a", -1.0), ("b", 1.0))
        ]  # fmt: skip
        if joint.friction_n_m:
            inertia = _inertia(joint.arm)
            turned = Coordinate(
                name, mass=inertia, damping=link.damping_n_m_s, low=link.low_rad,
                high=link.high_rad, stop_stiffness=JOINT_STOP_N_M_RAD,
                stop_damping=JOINT_STOP_N_M_S_RAD, coulomb=joint.friction_n_m,
            )  # fmt: skip
            self.scene = Scene(units, [turned])
        else:
            self.scene = Scene(units, arm=joint.arm)
        self.state, self.params = self.scene.world.units[0], self.scene.world.params[0]
        self._free_damping = float(self.scene.world.coords[0, sc.DAMPING])
        self._inertia = _inertia(joint.arm)

    def lock(self, angle_deg: float) -> None:
        """Turn the joint to an angle and hold it there. No time passes."""
        world = self.scene.world
        angle = math.radians(angle_deg)
        world.motion[sc.PLACE, 0], world.motion[sc.RATE, 0] = angle, 0.0
        world.motion[sc.SLIDING, 0] = 0.0
        stiffness = self.joint.lock_n_m_rad
        world.coords[0, sc.SPRING], world.coords[0, sc.SPRING_REST] = stiffness, angle
        damping = 2.0 * LOCK_DAMPING * math.sqrt(stiffness * self._inertia)
        world.coords[0, sc.DAMPING] = damping
        world.clock[sc.LONGEST_UNTIL] = 0.0
        self.scene.refresh()

    def release(self) -> None:
        """Take the lock off."""
        coords = self.scene.world.coords
        coords[0, sc.SPRING] = 0.0
        coords[0, sc.DAMPING] = self._free_damping
        self.scene.world.clock[sc.LONGEST_UNTIL] = 0.0

    @property
    def angle_deg(self) -> float:
        """Angle of the joint."""
        return math.degrees(float(self.scene.world.motion[sc.PLACE, 0]))

    @property
    def rate_deg_s(self) -> float:
        """How fast the joint turns."""
        return math.degrees(float(self.scene.world.motion[sc.RATE, 0]))

    @property
    def lock_torque_n_m(self) -> float:
        """Torque of the joint on its lock, positive towards larger angles; 0 without the lock."""
        coords = self.scene.world.coords
        turned = float(self.scene.world.motion[sc.PLACE, 0]) - float(coords[0, sc.SPRING_REST])
        return float(coords[0, sc.SPRING]) * turned

    @property
    def pressures_kpa(self) -> Array:
        """True gauge pressure of muscle a and b."""
        return self.scene.pressures_kpa


class JointBoard(SceneBoard):
    """The board of one of two muscles; both boards and the plant go on together.

    Attributes:
        pair: both boards, once they are made.
    """

    pair: Pair

    @property
    def on_s(self) -> tuple[float, float]:
        """How long inlet and outlet are open within the coming tick."""
        fill_s, vent_s = super().on_s
        return (
            TICK_S if self.inlet_jammed else fill_s,
            TICK_S if self.outlet_jammed else vent_s,
        )

    def run_until_us(self, until_us: int) -> None:
        """Advance both boards by whole ticks up to and including ``until_us``."""
        self.pair.run_until_us(until_us)


class Pair:
    """Steps the plant once a tick, then the firmware of both boards."""

    def __init__(self, plant: JointLoad, boards: tuple[JointBoard, JointBoard]) -> None:
        self._plant = plant
        self._boards = boards
        self._fill, self._vent = np.zeros((2, 2))
        for board in boards:
            board.pair = self

    def run_until_us(self, until_us: int) -> None:
        """Advance by whole ticks up to and including bench time ``until_us``."""
        first, second = self._boards
        while first.bench_us + TICK_US <= until_us:
            self._fill[0], self._vent[0] = first.on_s
            self._fill[1], self._vent[1] = second.on_s
            self._plant.scene.advance(TICK_S, self._fill, self._vent)
            now_us = first.bench_us + TICK_US
            SimBoard.run_until_us(first, now_us)
            SimBoard.run_until_us(second, now_us)
