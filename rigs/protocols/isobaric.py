"""The isobaric test: pressure held, length stepped, force read (thesis 4.8.2, Table C-2)."""

from __future__ import annotations

from dataclasses import dataclass

from analysis.findings.isobaric import ISOBARIC
from rigs.execution.procedure import Procedure
from rigs.protocols.parts.method import Method, MethodParameters, read_method
from rigs.protocols.parts.trials import VENTED_KPA, Logbook
from rigs.rigfile.acceptance import read_acceptance
from rigs.rigfile.config import RigConfig
from rigs.rigfile.toml_reader import load_toml
from rigs.steps.custom_step import Steps
from rigs.steps.steps import State
from rigs.steps.sweep import Sweeps, read_sweeps


@dataclass(frozen=True)
class Isobaric(MethodParameters):
    """Parameters of an isobaric test."""

    name: str
    pressures_kpa: tuple[float, ...]
    lengths_mm: tuple[float, ...]
    slack_length_mm: float
    method: Method
    sweeps: Sweeps | None = None
    source: str = ""

    def steps(self) -> Steps:
        """The method: for each pressure tare, hold it, and go through the lengths and back."""
        sweeps = self.sweeps.steps() if self.sweeps is not None else []
        book = Logbook(self.method, "isobaric", self.slack_length_mm)
        yield from book.opening(sum(self.lengths_mm) / len(self.lengths_mm))
        for place, pressure in self.method.trials(list(self.pressures_kpa)):
            yield from book.remount(place)
            yield from book.isobaric(place, pressure, book.path(self.lengths_mm))
            if sweeps and pressure >= VENTED_KPA:
                yield from book.swept(place, pressure, sweeps)
        yield State("done")


def read(name: str, config: RigConfig) -> Isobaric:
    """Read a protocol file, held against the rig's limits.

    Raises:
        ConfigError: unknown key, wrong type, or a value beyond the rig's limit.
    """
    t = load_toml(name, "protocols")
    t.text("protocol", choices=("isobaric",))
    low, high = config.limits.length_min_mm, config.limits.length_max_mm
    out = Isobaric(
        name=t.text("name", "isobaric"),
        pressures_kpa=t.numbers("pressures_kpa", 0, config.limits.pressure_kpa, unit="kPa"),
        lengths_mm=t.numbers("lengths_mm", low, high, unit="mm"),
        slack_length_mm=t.number("slack_length_mm", low, high, low, unit="mm"),
        method=read_method(t, config.limits, drift_n=0.05),
        sweeps=read_sweeps(t, config),
        acceptance=read_acceptance(t, ISOBARIC.results),
        source=t.source,
    )
    t.finish()
    return out


PROCEDURE = Procedure(
    ISOBARIC, read,
    # The stage squeezes the air that is shut in: the controller would take that for a leak.
    firmware={"leak_counts": 0},
)  # fmt: skip
