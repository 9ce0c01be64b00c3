"""What every test of a laboratory has in common: order, replicates, preconditioning, criteria."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from rigs.execution.procedure import Parameters, ProtocolParameters
from rigs.rigfile.config import Limits, RigConfig
from rigs.rigfile.toml_reader import Table
from rigs.steps.leak_check import LeakCheck
from rigs.steps.schedule import ORDERS, Place, T, arrange
from rigs.steps.steps import SettleCriterion


@dataclass(frozen=True)
class Method(Parameters):
    """The habits of a test, as read from its protocol file.

    Attributes:
        order: of settings and points, one of ``schedule.ORDERS``.
        repeats: replicates of each setting back to back, in each mounting.
        mountings: names of the mountings; the muscle is taken off and put back between two.
        leak: the check before the test, or None.
    """

    order: str
    repeats: int
    mountings: tuple[str, ...]
    seed: int
    precondition_cycles: int
    precondition_kpa: float
    precondition_dwell_s: float
    settle: SettleCriterion
    measure_s: float
    frames: int
    zero_s: float
    leak: LeakCheck | None

    def trials(self, settings: list[T]) -> Iterator[tuple[Place, T]]:
        """Every trial in order: its place and its setting."""
        return arrange(settings, self.order, self.repeats, self.mountings, self.seed)


class MethodParameters(ProtocolParameters):
    """Parameters of a test that has a method."""

    method: Method

    @property
    def frames(self) -> int:
        """Pictures at a point."""
        return self.method.frames


def read_method(
    t: Table, limits: Limits, drift_n: float | None = None, drift_mm: float | None = None
) -> Method:
    """Read the common keys of a protocol file; the caller reads its own and finishes ``t``.

    Args:
        t: root of the file.
        limits: of the rig.
        drift_n, drift_mm: default of that settling criterion; None where the test does not
            watch it.

    Raises:
        ConfigError: unknown key, wrong type, or a value beyond the rig's limit.
    """
    top = limits.pressure_kpa
    pre = t.table("precondition", optional=True)
    settle = t.table("settle", optional=True)
    measure = t.table("measure", optional=True)
    method = Method(
        order=t.text("order", "up-down", choices=ORDERS),
        repeats=t.integer("repeats", 1, 1000, 2),
        mountings=_read_names(t, "mountings", ("m1",)),
        seed=t.integer("seed", 0, 2**63 - 1, 1),
        precondition_cycles=pre.integer("cycles", 0, 1000, 3),
        precondition_kpa=pre.number("pressure_kpa", 0, top, min(400.0, top), unit="kPa"),
        precondition_dwell_s=pre.number("dwell_s", 0, 600, 1.0, unit="s"),
        settle=SettleCriterion(
            window_s=settle.number("window_s", 0.2, 60, 0.5, unit="s"),
            pressure_kpa=settle.number("pressure_kpa", 0.1, 100, 1.5, unit="kPa"),
            drift_kpa=settle.number("drift_kpa", 0.05, 100, 0.5, unit="kPa"),
            drift_n=None
            if drift_n is None
            else settle.number("drift_n", 0.001, 100, drift_n, unit="N"),
            timeout_s=settle.number("timeout_s", 0.5, 3600, 20.0, unit="s"),
            drift_mm=None
            if drift_mm is None
            else settle.number("drift_mm", 0.001, 10, drift_mm, unit="mm"),
        ),
        measure_s=measure.number("seconds", 0.2, 600, 1.0, unit="s"),
        frames=measure.integer("frames", 0 if drift_mm is None else 1, 1000, 1),
        zero_s=measure.number("zero_s", 0.2, 600, 0.5, unit="s"),
        leak=_read_leak(t, top),
    )
    for table in (pre, settle, measure):
        table.finish()
    return method


def refuse_hand_regulator(t: Table, config: RigConfig, does: str) -> None:
    """Refuse a test that moves the pressure by itself where a person turns the regulator.

    Args:
        t: the protocol file.
        config: the rig.
        does: what the test does with the pressure ("cycles").

    Raises:
        ConfigError: names the file.
    """
    if config.pressure_source.kind == "hand-regulator":
        raise t.fail(
            "protocol", f"{does} the pressure, and on {config.source} a person turns the regulator",
            "use a rig with solenoid valves or a proportional regulator",
        )  # fmt: skip


def _read_leak(root: Table, top_kpa: float) -> LeakCheck | None:
    """The table of the check before the test, or None where there is none.

    Raises:
        ConfigError: unknown key, wrong type, or a pressure beyond the rig's limit.
    """
    if "leak_check" not in root:
        return None
    t = root.table("leak_check")
    out = LeakCheck(
        pressure_kpa=t.number("pressure_kpa", 10, top_kpa, min(400.0, top_kpa), unit="kPa"),
        hold_s=t.number("hold_s", 0.5, 3600, 5.0, unit="s"),
        limit_kpa_s=t.number("limit_kpa_s", 0.01, 1000, 1.0, unit="kPa/s"),
    )
    t.finish()
    return out


def _read_names(t: Table, key: str, default: tuple[str, ...]) -> tuple[str, ...]:
    """A list of different names.

    Raises:
        ConfigError: it is something else.
    """
    values = t.raw(key, list(default))
    good = isinstance(values, list) and values and all(isinstance(v, str) and v for v in values)
    if not good or len(set(values)) != len(values):
        raise t.fail(key, f"expected a list of different names, got {values!r}")
    return tuple(values)
