"""What the tests of a joint have in common: pressures, order, settling, preconditioning."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from rigs.execution.procedure import Parameters
from rigs.rigfile.config import RigConfig
from rigs.rigfile.tables.joint import JointSettings
from rigs.rigfile.toml_reader import Table
from rigs.steps.custom_step import Steps
from rigs.steps.joint import VENTED_KPA, FreeJoint, JointCriterion, SetPressures, pressures_of
from rigs.steps.schedule import ORDERS
from rigs.steps.steps import Dwell, State, Vent

Names = dict[str, str]
"""Which instrument reads ``angle`` and which ``torque``; the screen of a test needs them."""

FIRMWARE = {"leak_counts": 0}
"""A joint that turns changes the pressure behind shut valves, so that is no leak."""


@dataclass(frozen=True)
class JointMethod(Parameters):
    """The habits of a test of a joint, as read from its protocol file."""

    order: str
    repeats: int
    mounting: str
    seed: int
    precondition_cycles: int
    precondition_kpa: float
    precondition_dwell_s: float

    def opening(self) -> Steps:
        """Fill and empty both muscles some times, the joint free."""
        if self.precondition_cycles:
            yield State("precondition")
            yield FreeJoint()
        for _ in range(self.precondition_cycles):
            yield SetPressures(self.precondition_kpa, self.precondition_kpa)
            yield Dwell(self.precondition_dwell_s)
            yield Vent()
            yield Dwell(self.precondition_dwell_s)


def read_method(t: Table, config: RigConfig) -> JointMethod:
    """The common keys of a protocol file.

    Raises:
        ConfigError: names file and key.
    """
    top = config.limits.pressure_kpa
    pre = t.table("precondition", optional=True)
    out = JointMethod(
        order=t.text("order", "up-down", choices=ORDERS),
        repeats=t.integer("repeats", 1, 1000, 1),
        mounting=t.text("mounting", "m1"),
        seed=t.integer("seed", 0, 2**63 - 1, 1),
        precondition_cycles=pre.integer("cycles", 0, 1000, 3),
        precondition_kpa=pre.number("pressure_kpa", VENTED_KPA, top, min(300.0, top), unit="kPa"),
        precondition_dwell_s=pre.number("dwell_s", 0, 600, 1.0, unit="s"),
    )
    pre.finish()
    return out


def read_settle(t: Table) -> JointCriterion:
    """The table ``[settle]`` of a protocol file. Raises `ConfigError`."""
    s = t.table("settle", optional=True)
    out = JointCriterion(
        window_s=s.number("window_s", 0.2, 60, 0.5, unit="s"),
        pressure_kpa=s.number("pressure_kpa", 0.1, 100, 1.5, unit="kPa"),
        drift_kpa=s.number("drift_kpa", 0.05, 100, 0.5, unit="kPa"),
        drift_deg=s.number("drift_deg", 0.001, 100, 0.05, unit="deg"),
        drift_n_m=s.number("drift_n_m", 1e-5, 100, 0.002, unit="N m"),
        timeout_s=s.number("timeout_s", 0.5, 3600, 20.0, unit="s"),
    )
    s.finish()
    return out


def joint_of(t: Table, config: RigConfig) -> JointSettings:
    """The joint of a rig. Raises `ConfigError` where it has none."""
    if config.joint is None:
        raise t.fail(
            "protocol", f"tests a joint, and {config.source} has no [joint]",
            "use the rig virtual-joint, or see docs/use/joint.md",
        )  # fmt: skip
    return config.joint


def names_of(joint: JointSettings) -> Names:
    """The instruments of a joint."""
    return {"angle": joint.angle, "torque": joint.torque}


def check_pairs(
    t: Table, config: RigConfig, commons: Sequence[float], key: str, differences: Sequence[float]
) -> None:
    """Every pair of pressures must be within the limits of the rig.

    Raises:
        ConfigError: names the pair.
    """
    top = config.limits.pressure_kpa
    for common in commons:
        for difference in differences:
            low, high = sorted(pressures_of(common, difference))
            if not (low == 0.0 or low >= VENTED_KPA) or high > top:
                raise t.fail(
                    key,
                    f"{difference:g} kPa at a common pressure of {common:g} kPa makes {low:g} and"
                    f" {high:g} kPa; allowed 0, and {VENTED_KPA:g} to {top:g} kPa",
                    "correct the difference, the common pressure or the rig's limit",
                )
