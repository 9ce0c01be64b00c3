"""The test of the free contraction: almost no load, pressure stepped, length read."""

from __future__ import annotations

from dataclasses import dataclass

from analysis.findings.muscle.limits import FREE_CONTRACTION
from rigs.execution.procedure import Procedure
from rigs.protocols.parts.method import Method, MethodParameters, read_method
from rigs.protocols.parts.trials import Logbook
from rigs.rigfile.config import RigConfig
from rigs.rigfile.toml_reader import load_toml
from rigs.steps.custom_step import Steps
from rigs.steps.loads import HangLoad
from rigs.steps.steps import State


@dataclass(frozen=True)
class FreeContraction(MethodParameters):
    """Parameters of a test of the free contraction."""

    name: str
    mass_kg: float
    pressures_kpa: tuple[float, ...]
    rest_length_mm: float
    u_rest_length_mm: float
    method: Method
    source: str = ""

    def steps(self) -> Steps:
        """The method: an isotonic trial under the lightest load for each replicate."""
        book = Logbook(self.method, "isotonic")
        yield State("load")
        yield HangLoad(self.mass_kg)
        yield from book.opening(None)
        for place, mass in self.method.trials([self.mass_kg]):
            yield from book.remount(place)
            yield from book.isotonic(place, mass, book.path(self.pressures_kpa))
        yield State("done")
        yield HangLoad(0.0)


def read(name: str, config: RigConfig) -> FreeContraction:
    """Read a protocol file, held against the rig's limits.

    Raises:
        ConfigError: unknown key, wrong type, or a value beyond the rig's limit; or no pressure of
            0 and no stated L0, without which there is no contraction.
    """
    t = load_toml(name, "protocols")
    t.text("protocol", choices=("free-contraction",))
    heaviest = config.limits.force_n / config.conditions.gravity_m_s2
    out = FreeContraction(
        name=t.text("name", "free-contraction"),
        mass_kg=t.number("mass_kg", 0.001, heaviest, unit="kg"),
        pressures_kpa=t.numbers("pressures_kpa", 0, config.limits.pressure_kpa, unit="kPa"),
        rest_length_mm=t.number("rest_length_mm", 0.0, 10_000.0, 0.0, unit="mm"),
        u_rest_length_mm=t.number("u_rest_length_mm", 0.0, 1000.0, 0.0, unit="mm"),
        method=read_method(t, config.limits, drift_mm=0.02),
        source=t.source,
    )
    if not out.rest_length_mm and 0.0 not in out.pressures_kpa:
        raise t.fail(
            "pressures_kpa", "has no 0, so that the length L0 at no pressure is not measured",
            "add 0, or state rest_length_mm",
        )  # fmt: skip
    t.finish()
    return out


PROCEDURE = Procedure(
    FREE_CONTRACTION, read,
    # A load that moves squeezes the air that is shut in: no leak.
    firmware={"leak_counts": 0},
)  # fmt: skip
