"""The isothermal test: isometric and isobaric trials repeated over temperatures (thesis 4.8.4)."""

from __future__ import annotations

from dataclasses import dataclass

from analysis.findings.isothermal import ISOTHERMAL
from rigs.execution.procedure import Procedure
from rigs.protocols.parts.method import Method, MethodParameters, read_method
from rigs.protocols.parts.trials import Logbook
from rigs.rigfile.acceptance import read_acceptance
from rigs.rigfile.config import RigConfig
from rigs.rigfile.toml_reader import load_toml
from rigs.steps.custom_step import Steps
from rigs.steps.steps import State
from rigs.steps.temperature import SetTemperature, SoakCriterion


@dataclass(frozen=True)
class Isothermal(MethodParameters):
    """Parameters of an isothermal test; either kind of trial may be left out."""

    name: str
    temperatures_c: tuple[float, ...]
    lengths_mm: tuple[float, ...]
    pressures_kpa: tuple[float, ...]
    isobaric_pressures_kpa: tuple[float, ...]
    isobaric_lengths_mm: tuple[float, ...]
    slack_length_mm: float
    soak: SoakCriterion
    method: Method
    source: str = ""

    def steps(self) -> Steps:
        """The method: at each temperature soak, precondition, then every trial at it."""
        book = Logbook(self.method, "isothermal", self.slack_length_mm)
        every = (*self.lengths_mm, *self.isobaric_lengths_mm)
        for temperature in self.temperatures_c:
            yield SetTemperature(temperature, self.soak)
            book.temperature_c = temperature
            yield from book.opening(sum(every) / len(every))
            for place, length in self.method.trials(list(self.lengths_mm)):
                yield from book.remount(place)
                yield from book.isometric(place, length, book.path(self.pressures_kpa))
            for place, pressure in self.method.trials(list(self.isobaric_pressures_kpa)):
                yield from book.remount(place)
                yield from book.isobaric(place, pressure, book.path(self.isobaric_lengths_mm))
        yield State("done")


def read(name: str, config: RigConfig) -> Isothermal:
    """Read a protocol file, held against the rig's limits and instruments.

    Raises:
        ConfigError: unknown key, wrong type, a value beyond the rig's limit, no thermometer.
    """
    t = load_toml(name, "protocols")
    t.text("protocol", choices=("isothermal",))
    if "thermometer" not in config.instruments.text:
        raise t.fail(
            "protocol",
            f"needs a thermometer, and {config.source} has no [thermometer]",
            "add it (docs/reference/instruments.md), or try --rig virtual-instruments",
        )
    low, high = config.limits.length_min_mm, config.limits.length_max_mm
    top = config.limits.pressure_kpa
    soak = t.table("soak", optional=True)
    bars = t.table("isobaric", optional=True)
    out = Isothermal(
        name=t.text("name", "isothermal"),
        temperatures_c=t.numbers("temperatures_c", -20, 80, unit="°C"),
        lengths_mm=t.numbers("lengths_mm", low, high, (), unit="mm", least=0),
        pressures_kpa=t.numbers("pressures_kpa", 0, top, (), unit="kPa", least=0),
        isobaric_pressures_kpa=bars.numbers("pressures_kpa", 0, top, (), unit="kPa", least=0),
        isobaric_lengths_mm=bars.numbers("lengths_mm", low, high, (), unit="mm", least=0),
        slack_length_mm=t.number("slack_length_mm", low, high, low, unit="mm"),
        soak=SoakCriterion(
            soak_s=soak.number("soak_s", 1, 36000, 300.0, unit="s"),
            tolerance_c=soak.number("tolerance_c", 0.05, 20, 0.5, unit="°C"),
            drift_c=soak.number("drift_c", 0.01, 20, 0.3, unit="°C"),
            timeout_s=soak.number("timeout_s", 1, 86400, 7200.0, unit="s"),
        ),
        method=read_method(t, config.limits, drift_n=0.05),
        acceptance=read_acceptance(t, ISOTHERMAL.results),
        source=t.source,
    )
    for table in (soak, bars, t):
        table.finish()
    for key, one, other in (
        ("lengths_mm", out.lengths_mm, out.pressures_kpa),
        ("isobaric", out.isobaric_lengths_mm, out.isobaric_pressures_kpa),
    ):
        if bool(one) != bool(other):
            raise t.fail(key, "lengths without pressures, or pressures without lengths", "add them")
    if not out.lengths_mm and not out.isobaric_lengths_mm:
        raise t.fail("lengths_mm", "neither an isometric nor an isobaric trial", "name lengths")
    return out


PROCEDURE = Procedure(
    ISOTHERMAL, read,
    # The stage squeezes the air that is shut in: the controller would take that for a leak.
    firmware={"leak_counts": 0},
)  # fmt: skip
