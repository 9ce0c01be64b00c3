"""The step test of a joint: how the angle answers to a step of the differential pressure."""

from __future__ import annotations

from dataclasses import dataclass, field

from analysis.findings.joint import JOINT_STEP
from rigs.execution.procedure import Procedure, ProtocolParameters
from rigs.protocols.joint.method import (
    FIRMWARE,
    JointMethod,
    Names,
    check_pairs,
    joint_of,
    names_of,
    read_method,
)
from rigs.rigfile.acceptance import read_acceptance
from rigs.rigfile.config import RigConfig
from rigs.rigfile.toml_reader import load_toml
from rigs.steps.custom_step import Steps
from rigs.steps.joint import VENTED_KPA, EqualPressures, FreeJoint, JointResponse, JointZero
from rigs.steps.schedule import arrange
from rigs.steps.steps import EndTrial, State, Trial, Vent


@dataclass(frozen=True)
class JointStep(ProtocolParameters):
    """Parameters of a step test of a joint, as read from its protocol file."""

    name: str
    common_kpa: tuple[float, ...]
    difference_kpa: tuple[float, ...]
    step_s: float
    last_s: float
    band_percent: float
    method: JointMethod
    zero_s: float
    instruments: Names
    source: str = ""
    frames: int = field(default=0, init=False)

    def steps(self) -> Steps:
        """The method: at each common pressure, from difference to difference as listed."""
        method = self.method
        yield from method.opening()
        steps = list(zip(self.difference_kpa[:-1], self.difference_kpa[1:], strict=True))
        order = 0
        trials = arrange(
            self.common_kpa, method.order, method.repeats, (method.mounting,), method.seed
        )
        for trial, (place, common) in enumerate(trials, start=1):
            slot = f"C{common:g}"
            yield State(f"trial {trial}: {common:g} kPa, replicate {place.replicate}")
            yield Trial(
                trial, slot, place.replicate, trial, place.mounting, "joint-step",
                (("common_kpa", common),),
            )  # fmt: skip
            yield FreeJoint()
            yield JointZero(trial, "before", self.zero_s)
            yield EqualPressures(common)
            for number, (before, after) in enumerate(steps):
                order += 1
                yield JointResponse(
                    trial, f"{slot} {before:g} to {after:g}", place.replicate, order,
                    place.mounting, common, before, after, self.step_s, number == 0,
                )  # fmt: skip
            yield EqualPressures(common)
            yield Vent()
            yield EndTrial(trial)
        yield State("done")


def read(name: str, config: RigConfig) -> JointStep:
    """The protocol file, held against the rig.

    Raises:
        ConfigError: names file and key.
    """
    t = load_toml(name, "protocols")
    t.text("protocol", choices=("joint-step",))
    joint = joint_of(t, config)
    top = config.limits.pressure_kpa
    step_s = t.number("step_s", 0.3, 600, 2.0, unit="s")
    measure = t.table("measure", optional=True)
    plan = JointStep(
        name=t.text("name", "joint-step"),
        common_kpa=t.numbers("common_kpa", VENTED_KPA, top, unit="kPa"),
        difference_kpa=t.numbers("difference_kpa", -2 * top, 2 * top, unit="kPa", least=2),
        step_s=step_s,
        last_s=t.number("last_s", 0.1, step_s / 2, min(0.5, step_s / 2), unit="s"),
        band_percent=t.number("band_percent", 0.1, 50, 5.0),
        method=read_method(t, config),
        zero_s=measure.number("zero_s", 0.2, 600, 0.5, unit="s"),
        instruments=names_of(joint),
        acceptance=read_acceptance(t, JOINT_STEP.results),
        source=t.source,
    )
    measure.finish()
    check_pairs(t, config, plan.common_kpa, "difference_kpa", plan.difference_kpa)
    for one, other in zip(plan.difference_kpa[:-1], plan.difference_kpa[1:], strict=True):
        if one == other:
            raise t.fail("difference_kpa", f"{one:g} kPa twice in a row is no step", "remove one")
    t.finish()
    return plan


PROCEDURE = Procedure(JOINT_STEP, read, firmware=FIRMWARE, on_joint=True)
