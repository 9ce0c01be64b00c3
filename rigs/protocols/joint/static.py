"""The static test of a joint between two muscles: equilibrium angle, torque and stiffness.

With the joint free, the angle is read over common and differential pressure. With the joint locked
at some angles, the torque on the lock is read at the same pressures; its slope over the angle is
the stiffness. Locked, each muscle may also be put under pressure alone, which gives its force.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from analysis.findings.joint import JOINT_STATIC
from rigs.execution.procedure import Procedure, ProtocolParameters
from rigs.protocols.joint.method import (
    FIRMWARE,
    JointMethod,
    Names,
    check_pairs,
    joint_of,
    names_of,
    read_method,
    read_settle,
)
from rigs.rigfile.acceptance import read_acceptance
from rigs.rigfile.config import RigConfig
from rigs.rigfile.toml_reader import load_toml
from rigs.steps.custom_step import Steps
from rigs.steps.joint import (
    VENTED_KPA,
    EqualPressures,
    FreeJoint,
    JointCriterion,
    JointPoint,
    JointZero,
    LockJoint,
    Pressures,
    pressures_of,
)
from rigs.steps.schedule import Place, arrange, path
from rigs.steps.steps import EndTrial, State, Trial, Vent


@dataclass(frozen=True)
class JointStatic(ProtocolParameters):
    """Parameters of a static test of a joint, as read from its protocol file."""

    name: str
    common_kpa: tuple[float, ...]
    difference_kpa: tuple[float, ...]
    free: bool
    angles_deg: tuple[float, ...]
    alone_kpa: tuple[float, ...]
    method: JointMethod
    settle: JointCriterion
    measure_s: float
    zero_s: float
    instruments: Names
    source: str = ""
    frames: int = field(default=0, init=False)

    def steps(self) -> Steps:
        """The method: precondition; a trial with the joint free; a trial at each locked angle."""
        method = self.method
        yield from method.opening()
        settings: list[float | None] = [None] if self.free else []
        settings += self.angles_deg
        rng = np.random.default_rng([method.seed, 2])
        order = 0
        trials = arrange(settings, method.order, method.repeats, (method.mounting,), method.seed)
        for trial, (place, angle) in enumerate(trials, start=1):
            slot = "free" if angle is None else f"locked at {angle:g}°"
            held = () if angle is None else (("held_angle_deg", angle),)
            yield State(f"trial {trial}: {slot}, replicate {place.replicate}")
            yield Trial(trial, slot, place.replicate, trial, place.mounting, "joint-static", held)
            yield FreeJoint() if angle is None else LockJoint(angle)
            yield JointZero(trial, "before", self.zero_s)
            if angle is None:
                yield EqualPressures(self.common_kpa[0])
            for state, direction, pressures in self._points(angle, rng):
                order += 1
                yield self._point(trial, slot, place, order, state, direction, pressures, angle)
            if angle is None:
                yield EqualPressures(self.common_kpa[-1])
            yield Vent()
            yield JointZero(trial, "after", self.zero_s)
            yield EndTrial(trial)
        yield State("done")

    def _points(
        self, angle: float | None, rng: np.random.Generator
    ) -> list[tuple[str, str, Pressures]]:
        """The points of a trial: state, direction, and both pressures."""
        order = self.method.order
        state = "free" if angle is None else "locked"
        points = [
            (state, direction, pressures_of(common, difference))
            for common in self.common_kpa
            for direction, difference in path(self.difference_kpa, order, rng)
        ]
        if angle is not None and self.alone_kpa:
            for direction, pressure in path(self.alone_kpa, order, rng):
                points.append(("a", direction, (pressure, 0.0)))
            for direction, pressure in path(self.alone_kpa, order, rng):
                points.append(("b", direction, (0.0, pressure)))
        return points

    def _point(
        self,
        trial: int,
        slot: str,
        place: Place,
        order: int,
        state: str,
        direction: str,
        pressures: Pressures,
        angle: float | None,
    ) -> JointPoint:
        return JointPoint(
            trial, slot, place.replicate, order, place.mounting, direction, state,
            pressures[0], pressures[1], angle, self.settle, self.measure_s,
        )  # fmt: skip


def read(name: str, config: RigConfig) -> JointStatic:
    """The protocol file, held against the rig.

    Raises:
        ConfigError: names file and key.
    """
    t = load_toml(name, "protocols")
    t.text("protocol", choices=("joint-static",))
    joint = joint_of(t, config)
    top = config.limits.pressure_kpa
    measure = t.table("measure", optional=True)
    plan = JointStatic(
        name=t.text("name", "joint-static"),
        common_kpa=t.numbers("common_kpa", VENTED_KPA, top, unit="kPa"),
        difference_kpa=t.numbers("difference_kpa", -2 * top, 2 * top, unit="kPa"),
        free=t.flag("free", True),
        angles_deg=t.numbers("angles_deg", joint.low_deg, joint.high_deg, (), unit="deg", least=0),
        alone_kpa=t.numbers("alone_kpa", VENTED_KPA, top, (), unit="kPa", least=0),
        method=read_method(t, config),
        settle=read_settle(t),
        measure_s=measure.number("seconds", 0.2, 600, 1.0, unit="s"),
        zero_s=measure.number("zero_s", 0.2, 600, 0.5, unit="s"),
        instruments=names_of(joint),
        acceptance=read_acceptance(t, JOINT_STATIC.results),
        source=t.source,
    )
    measure.finish()
    check_pairs(t, config, plan.common_kpa, "difference_kpa", plan.difference_kpa)
    if plan.angles_deg and not joint.torque:
        raise t.fail(
            "angles_deg", f"a locked joint needs a torque, and {config.source} reads none",
            "add joint.torque to the rig, or remove angles_deg",
        )  # fmt: skip
    if not (plan.angles_deg or plan.free):
        raise t.fail("free", "is false and angles_deg is empty: nothing is measured", "give one")
    if plan.alone_kpa and not plan.angles_deg:
        raise t.fail("alone_kpa", "needs a locked joint", "add angles_deg")
    t.finish()
    return plan


PROCEDURE = Procedure(JOINT_STATIC, read, firmware=FIRMWARE, on_joint=True)
