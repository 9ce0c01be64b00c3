"""The relaxation test: length and pressure held, the force read at times that grow by a factor."""

from __future__ import annotations

from dataclasses import dataclass

from analysis.findings.muscle.held import RELAXATION
from rigs.execution.procedure import Procedure
from rigs.protocols.muscle.times import Times, read_times
from rigs.protocols.parts.method import Method, MethodParameters, read_method
from rigs.protocols.parts.trials import VENTED_KPA, Logbook
from rigs.rigfile.config import RigConfig
from rigs.rigfile.toml_reader import load_toml
from rigs.steps.custom_step import Steps
from rigs.steps.muscle.held import Hold
from rigs.steps.steps import Dwell, SetLength, State, Vent, Zero


@dataclass(frozen=True)
class Relaxation(MethodParameters):
    """Parameters of a relaxation test.

    With ``from_length_mm`` the muscle is pressurised at that length, and times count from its
    arrival at the length that is held. Without (0), they count from the command of the pressure.
    """

    name: str
    lengths_mm: tuple[float, ...]
    pressures_kpa: tuple[float, ...]
    from_length_mm: float
    times: Times
    recover_s: float
    slack_length_mm: float
    method: Method
    source: str = ""

    def steps(self) -> Steps:
        """The method: tare, recover, pressurise, hold each length at each pressure."""
        book = Logbook(self.method, "relaxation", self.slack_length_mm)
        yield from book.opening(sum(self.lengths_mm) / len(self.lengths_mm))
        settings = [(length, p) for length in self.lengths_mm for p in self.pressures_kpa]
        for place, (length, pressure) in self.method.trials(settings):
            yield from book.remount(place)
            slot = f"{length:g} mm, {pressure:g} kPa"
            held = (("held_length_mm", length), ("held_pressure_kpa", pressure))
            yield from book.begin(place, slot, "relaxation", held)
            yield from book.tared()
            yield Dwell(self.recover_s)
            yield SetLength(self.from_length_mm or length)
            yield Zero(book.trial, "before", self.method.zero_s)
            moved = length if self.from_length_mm else None
            hold = Hold(book.trial, pressure, self.method.settle, moved)
            yield from self.times.held(book, place, slot, hold, length, None)
            yield Vent()
            yield from book.end()
        yield State("done")


def read(name: str, config: RigConfig) -> Relaxation:
    """Read a protocol file, held against the rig's limits.

    Raises:
        ConfigError: unknown key, wrong type, or a value beyond the rig's limit.
    """
    t = load_toml(name, "protocols")
    t.text("protocol", choices=("relaxation",))
    top = config.limits.pressure_kpa
    low, high = config.limits.length_min_mm, config.limits.length_max_mm
    out = Relaxation(
        name=t.text("name", "relaxation"),
        lengths_mm=t.numbers("lengths_mm", low, high, unit="mm"),
        pressures_kpa=t.numbers("pressures_kpa", VENTED_KPA, top, unit="kPa"),
        from_length_mm=t.number("from_length_mm", 0.0, high, 0.0, unit="mm"),
        times=read_times(t, frames=0),
        recover_s=t.number("recover_s", 0.0, 30 * 86400.0, 0.0, unit="s"),
        slack_length_mm=t.number("slack_length_mm", low, high, low, unit="mm"),
        method=read_method(t, config.limits, drift_n=0.05),
        source=t.source,
    )
    if 0.0 < out.from_length_mm < low:
        raise t.fail("from_length_mm", f"is below the rig's {low:g} mm; 0 stands for no move")
    t.finish()
    return out


PROCEDURE = Procedure(
    RELAXATION, read,
    # The stage squeezes the air that is shut in: the controller would take that for a leak.
    firmware={"leak_counts": 0},
)  # fmt: skip
