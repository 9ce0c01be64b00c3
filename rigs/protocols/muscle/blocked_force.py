"""The test of the blocked force: the slack length L0 held, pressure stepped, force read."""

from __future__ import annotations

from dataclasses import dataclass

from analysis.findings.muscle.limits import BLOCKED_FORCE
from rigs.execution.procedure import Procedure
from rigs.protocols.parts.method import Method, MethodParameters, read_method
from rigs.protocols.parts.trials import Logbook
from rigs.rigfile.config import RigConfig
from rigs.rigfile.toml_reader import load_toml
from rigs.steps.custom_step import Steps
from rigs.steps.steps import State


@dataclass(frozen=True)
class BlockedForce(MethodParameters):
    """Parameters of a test of the blocked force."""

    name: str
    rest_length_mm: float
    pressures_kpa: tuple[float, ...]
    slack_length_mm: float
    method: Method
    source: str = ""

    def steps(self) -> Steps:
        """The method: an isometric trial at L0 for each replicate."""
        book = Logbook(self.method, "isometric", self.slack_length_mm)
        yield from book.opening(self.rest_length_mm)
        for place, length in self.method.trials([self.rest_length_mm]):
            yield from book.remount(place)
            yield from book.isometric(place, length, book.path(self.pressures_kpa))
        yield State("done")


def read(name: str, config: RigConfig) -> BlockedForce:
    """Read a protocol file, held against the rig's limits.

    Raises:
        ConfigError: unknown key, wrong type, or a value beyond the rig's limit.
    """
    t = load_toml(name, "protocols")
    t.text("protocol", choices=("blocked-force",))
    low, high = config.limits.length_min_mm, config.limits.length_max_mm
    out = BlockedForce(
        name=t.text("name", "blocked-force"),
        rest_length_mm=t.number("rest_length_mm", low, high, unit="mm"),
        pressures_kpa=t.numbers("pressures_kpa", 0, config.limits.pressure_kpa, unit="kPa"),
        slack_length_mm=t.number("slack_length_mm", low, high, low, unit="mm"),
        method=read_method(t, config.limits, drift_n=0.05),
        source=t.source,
    )
    t.finish()
    return out


PROCEDURE = Procedure(BLOCKED_FORCE, read)
