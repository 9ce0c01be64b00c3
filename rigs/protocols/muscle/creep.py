"""The creep test: pressure and load held, the length read at times that grow by a factor."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from analysis.findings.muscle.held import CREEP
from rigs.execution.procedure import Procedure
from rigs.protocols.isotonic import read_masses
from rigs.protocols.muscle.times import Times, read_times
from rigs.protocols.parts.method import Method, MethodParameters, read_method
from rigs.protocols.parts.trials import VENTED_KPA, Logbook
from rigs.rigfile.config import RigConfig
from rigs.rigfile.toml_reader import load_toml
from rigs.steps.custom_step import Steps
from rigs.steps.loads import HangLoad, LowerLoad
from rigs.steps.muscle.held import Hold
from rigs.steps.steps import Dwell, State, Zero


@dataclass(frozen=True)
class Creep(MethodParameters):
    """Parameters of a creep test."""

    name: str
    masses_kg: tuple[float, ...]
    pressures_kpa: tuple[float, ...]
    times: Times
    recover_s: float
    method: Method
    source: str = ""

    def steps(self) -> Steps:
        """The method: hang each load, hold each pressure, and let the muscle recover vented."""
        book = Logbook(self.method, "creep")
        yield State("first load")
        yield HangLoad(self.masses_kg[0])
        yield from book.opening(None)
        settings = [(mass, p) for mass in self.masses_kg for p in self.pressures_kpa]
        for place, (mass, pressure) in self.method.trials(settings):
            yield from book.remount(place)
            place, slot, hung = yield from book.begin_hung(
                place, mass, partial(_slot, pressure), "creep",
                (("held_pressure_kpa", pressure),),
            )  # fmt: skip
            yield Dwell(self.recover_s)
            yield Zero(book.trial, "before", self.method.zero_s)
            hold = Hold(book.trial, pressure, self.method.settle)
            yield from self.times.held(book, place, slot, hold, None, hung)
            yield LowerLoad()
            yield from book.end()
        yield State("done")
        yield HangLoad(0.0)


def _slot(pressure_kpa: float, mass_kg: float) -> str:
    return f"{mass_kg:.10g} kg, {pressure_kpa:g} kPa"


def read(name: str, config: RigConfig) -> Creep:
    """Read a protocol file, held against the rig's limits.

    Raises:
        ConfigError: unknown key, wrong type, or a value beyond the rig's limit.
    """
    t = load_toml(name, "protocols")
    t.text("protocol", choices=("creep",))
    top = config.limits.pressure_kpa
    out = Creep(
        name=t.text("name", "creep"),
        masses_kg=read_masses(t, config),
        pressures_kpa=t.numbers("pressures_kpa", VENTED_KPA, top, unit="kPa"),
        times=read_times(t, frames=1),
        recover_s=t.number("recover_s", 0.0, 30 * 86400.0, 0.0, unit="s"),
        method=read_method(t, config.limits, drift_mm=0.02),
        source=t.source,
    )
    t.finish()
    return out


PROCEDURE = Procedure(
    CREEP, read,
    # A load that moves squeezes the air that is shut in: no leak.
    firmware={"leak_counts": 0},
)  # fmt: skip
