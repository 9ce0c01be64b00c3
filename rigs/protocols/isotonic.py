"""The isotonic test: a load hung, pressure stepped, length read by the camera (thesis 4.8.3)."""

from __future__ import annotations

from dataclasses import dataclass

from analysis.findings.isotonic import ISOTONIC
from rigs.execution.procedure import Procedure
from rigs.protocols.parts.method import Method, MethodParameters, read_method
from rigs.protocols.parts.trials import Logbook
from rigs.rigfile.acceptance import read_acceptance
from rigs.rigfile.config import RigConfig
from rigs.rigfile.toml_reader import Table, load_toml
from rigs.steps.custom_step import Steps
from rigs.steps.loads import HangLoad
from rigs.steps.steps import State


@dataclass(frozen=True)
class Isotonic(MethodParameters):
    """Parameters of an isotonic test."""

    name: str
    masses_kg: tuple[float, ...]
    pressures_kpa: tuple[float, ...]
    method: Method
    rest_length_mm: float = 0.0
    source: str = ""

    def steps(self) -> Steps:
        """The method: hang each load, lift it through the pressures and let it down again."""
        book = Logbook(self.method, "isotonic")
        yield State("first load")
        yield HangLoad(self.masses_kg[0])
        yield from book.opening(None)
        for place, mass in self.method.trials(list(self.masses_kg)):
            yield from book.remount(place)
            yield from book.isotonic(place, mass, book.path(self.pressures_kpa))
        yield State("done")
        yield HangLoad(0.0)


def read(name: str, config: RigConfig) -> Isotonic:
    """Read a protocol file, held against the rig's limits.

    Raises:
        ConfigError: unknown key, wrong type, or a value beyond the rig's limit.
    """
    t = load_toml(name, "protocols")
    t.text("protocol", choices=("isotonic",))
    out = Isotonic(
        name=t.text("name", "isotonic"),
        masses_kg=read_masses(t, config),
        pressures_kpa=t.numbers("pressures_kpa", 0, config.limits.pressure_kpa, unit="kPa"),
        method=read_method(t, config.limits, drift_mm=0.02),
        rest_length_mm=t.number("rest_length_mm", 0.0, 10_000.0, 0.0, unit="mm"),
        acceptance=read_acceptance(t, ISOTONIC.results),
        source=t.source,
    )
    t.finish()
    return out


def read_masses(t: Table, config: RigConfig) -> tuple[float, ...]:
    """The masses to hang, below the rig's limit of force."""
    heaviest = config.limits.force_n / config.conditions.gravity_m_s2
    return t.numbers("masses_kg", 0.01, heaviest, unit="kg")


PROCEDURE = Procedure(
    ISOTONIC, read,
    # A load that moves squeezes the air that is shut in: no leak.
    firmware={"leak_counts": 0},
)  # fmt: skip
