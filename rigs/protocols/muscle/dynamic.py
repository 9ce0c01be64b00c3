"""The dynamic test: the set-point of the pressure follows sines and chirps."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from analysis.findings.muscle.dynamic import DYNAMIC
from analysis.reduction.muscle.energy import Air
from rigs.execution.procedure import Parameters, Procedure
from rigs.protocols.parts.air import read_air
from rigs.protocols.parts.method import Method, MethodParameters, read_method, refuse_hand_regulator
from rigs.protocols.parts.trials import VENTED_KPA, Logbook
from rigs.rigfile.config import RigConfig
from rigs.rigfile.toml_reader import Table, load_toml
from rigs.steps.custom_step import Steps
from rigs.steps.loads import HangLoad, LowerLoad
from rigs.steps.muscle.excite import Excitation
from rigs.steps.schedule import Place
from rigs.steps.steps import SetLength, SetPressure, Settle, State, Vent, Zero

FEWEST_PERIODS = 3


@dataclass(frozen=True)
class Sines(Parameters):
    """Sines one after the other; ``periods`` of each count, after ``lead_s``."""

    frequencies_hz: tuple[float, ...]
    periods: int
    least_s: float
    lead_s: float


@dataclass(frozen=True)
class Chirp(Parameters):
    """Equal sweeps from one frequency to another; the first is not counted."""

    from_hz: float
    to_hz: float
    sweep_s: float
    sweeps: int


@dataclass(frozen=True)
class Dynamic(MethodParameters):
    """Parameters of a dynamic test; the muscle is held at a length, or a load hangs on it."""

    name: str
    length_mm: float
    mass_kg: float
    means_kpa: tuple[float, ...]
    amplitudes_kpa: tuple[float, ...]
    update_hz: float
    stop_below: float
    sines: Sines | None
    chirp: Chirp | None
    slack_length_mm: float
    method: Method
    air: Air | None = None
    source: str = ""

    def as_dict(self) -> dict[str, Any]:
        """Plain values for run.json, without a table that the file does not have."""
        return {k: v for k, v in super().as_dict().items() if k != "air" or v is not None}

    def steps(self) -> Steps:
        """The method: at each mean and amplitude the sines, then the sweeps."""
        book = Logbook(self.method, "dynamic", self.slack_length_mm)
        hung = self.mass_kg
        if self.mass_kg:
            yield State("load")
            answer = yield HangLoad(self.mass_kg)
            hung = hung if answer is None else float(answer)
        yield from book.opening(None if self.mass_kg else self.length_mm)
        settings = [(mean, size) for mean in self.means_kpa for size in self.amplitudes_kpa]
        for place, (mean, size) in self.method.trials(settings):
            yield from book.remount(place)
            yield from self._trial(book, place, mean, size, hung)
        yield State("done")
        if self.mass_kg:
            yield HangLoad(0.0)

    def _trial(self, book: Logbook, place: Place, mean: float, size: float, hung: float) -> Steps:
        slot = f"{mean:g} ± {size:g} kPa"
        held = ("load_kg", hung) if self.mass_kg else ("held_length_mm", self.length_mm)
        yield from book.begin(place, slot, "dynamic", (held, ("held_pressure_kpa", mean)))
        if not self.mass_kg:
            yield from book.tared()
            yield SetLength(self.length_mm)
        yield Zero(book.trial, "before", self.method.zero_s)
        yield SetPressure(mean)
        yield Settle(self.method.settle, mean)
        named = (
            ("mass_kg", hung) if self.mass_kg else ("set_length_mm", self.length_mm),
        )  # fmt: skip

        def excitation(
            shape: str, ends: tuple[float, float], period_s: float, lead: int, periods: int
        ) -> Excitation:
            book.order += 1
            return Excitation(
                book.trial, slot, place.replicate, book.order, place.mounting, shape, *ends,
                period_s, lead, periods, mean, size, self.update_hz, self.stop_below, named,
            )  # fmt: skip

        for f in self.sines.frequencies_hz if self.sines else ():
            assert self.sines is not None
            periods = max(self.sines.periods, math.ceil(self.sines.least_s * f))
            lead = max(1, math.ceil(self.sines.lead_s * f))
            follows = yield excitation("sine", (f, f), 1.0 / f, lead, periods)
            if follows is False:
                break
        if (c := self.chirp) is not None:
            yield excitation("chirp", (c.from_hz, c.to_hz), c.sweep_s, 1, c.sweeps)
        yield LowerLoad() if self.mass_kg else Vent()
        yield from book.end()


def read(name: str, config: RigConfig) -> Dynamic:
    """Read a protocol file, held against the rig's limits.

    Raises:
        ConfigError: unknown key, wrong type, a value beyond the rig's limit, or a source of
            pressure that a person turns.
    """
    t = load_toml(name, "protocols")
    t.text("protocol", choices=("dynamic",))
    refuse_hand_regulator(t, config, "moves")
    top = config.limits.pressure_kpa
    low, high = config.limits.length_min_mm, config.limits.length_max_mm
    heaviest = config.limits.force_n / config.conditions.gravity_m_s2
    mass = t.number("mass_kg", 0.0, heaviest, 0.0, unit="kg")
    out = Dynamic(
        name=t.text("name", "dynamic"),
        length_mm=0.0 if mass else t.number("length_mm", low, high, unit="mm"),
        mass_kg=mass,
        means_kpa=t.numbers("means_kpa", VENTED_KPA, top, unit="kPa"),
        amplitudes_kpa=t.numbers("amplitudes_kpa", 0.5, top, unit="kPa"),
        update_hz=t.number("update_hz", 1.0, 200.0, 50.0, unit="Hz"),
        stop_below=t.number("stop_below", 0.0, 0.9, 0.1),
        sines=_read_sines(t),
        chirp=_read_chirp(t),
        slack_length_mm=t.number("slack_length_mm", low, high, low, unit="mm"),
        method=read_method(t, config.limits, drift_n=None if mass else 0.1),
        air=read_air(t),
        source=t.source,
    )
    for mean in out.means_kpa:
        for size in out.amplitudes_kpa:
            if mean - size < VENTED_KPA or mean + size > top:
                raise t.fail(
                    "amplitudes_kpa",
                    f"{mean:g} ± {size:g} kPa goes beyond {VENTED_KPA:g} to {top:g} kPa",
                    "correct mean, amplitude or the rig's limit",
                )
    if out.sines is None and out.chirp is None:
        raise t.fail("sines", "is missing, and so is [chirp]: nothing is measured", "add one")
    highest = max(out.sines.frequencies_hz if out.sines else (0.0,))
    highest = max(highest, out.chirp.to_hz if out.chirp else 0.0)
    if highest > out.update_hz / 4.0:
        raise t.fail(
            "update_hz", f"{out.update_hz:g} Hz makes fewer than four set-points in a period of"
            f" {highest:g} Hz", "raise it, or lower the highest frequency",
        )  # fmt: skip
    t.finish()
    return out


def _read_sines(root: Table) -> Sines | None:
    if "sines" not in root:
        return None
    t = root.table("sines")
    out = Sines(
        t.numbers("frequencies_hz", 0.001, 50.0, unit="Hz"),
        t.integer("periods", FEWEST_PERIODS, 10_000, 8),
        t.number("least_s", 0.0, 3600.0, 0.0, unit="s"),
        t.number("lead_s", 0.0, 3600.0, 1.0, unit="s"),
    )
    t.finish()
    return out


def _read_chirp(root: Table) -> Chirp | None:
    if "chirp" not in root:
        return None
    t = root.table("chirp")
    low = t.number("from_hz", 0.001, 50.0, unit="Hz")
    out = Chirp(
        low,
        t.number("to_hz", low * 1.5, 50.0, unit="Hz"),
        t.number("sweep_s", 2.0 / low, 86400.0, unit="s"),
        t.integer("sweeps", FEWEST_PERIODS, 1000, 5),
    )
    t.finish()
    return out


PROCEDURE = Procedure(
    DYNAMIC, read,
    # A pressure that swings keeps the valves busy: no leak.
    firmware={"leak_counts": 0},
)  # fmt: skip
