"""The fatigue test: cycles between two pressures until a number, or until the muscle fails."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from analysis.findings.muscle.fatigue import FATIGUE
from analysis.reduction.muscle.energy import Air
from rigs.execution.procedure import Parameters, Procedure
from rigs.protocols.parts.air import read_air
from rigs.protocols.parts.method import Method, MethodParameters, read_method, refuse_hand_regulator
from rigs.protocols.parts.trials import VENTED_KPA, Logbook
from rigs.rigfile.config import RigConfig
from rigs.rigfile.toml_reader import load_toml
from rigs.steps.custom_step import Steps
from rigs.steps.loads import HangLoad, LowerLoad
from rigs.steps.muscle.cycles import CYCLES, Cycle, CycleLog, Kept, Limits
from rigs.steps.schedule import Place
from rigs.steps.steps import SetLength, State, Vent, Zero

if TYPE_CHECKING:
    from daq.store.run import Run


@dataclass(frozen=True)
class LeakCycles(Parameters):
    """The leak is measured every so many cycles (0: never), for ``hold_s``."""

    every: int
    hold_s: float


@dataclass(frozen=True)
class Fatigue(MethodParameters):
    """Parameters of a fatigue test; the muscle is held at a length, or a load hangs on it."""

    name: str
    length_mm: float
    mass_kg: float
    low_kpa: float
    high_kpa: float
    rate_hz: float
    cycles: int
    kept: Kept
    limits: Limits
    leak: LeakCycles
    air: Air | None
    slack_length_mm: float
    method: Method
    source: str = ""

    def steps(self) -> Steps:
        """The method, from the first cycle."""
        return self.part(1, 1)

    def part(self, first: int, trial: int) -> Steps:
        """Opening, tare, and the cycles from ``first`` on, as one trial."""
        book = Logbook(self.method, "fatigue", self.slack_length_mm, trial=trial - 1)
        hung = self.mass_kg
        if self.mass_kg:
            yield State("load")
            answer = yield HangLoad(self.mass_kg)
            hung = hung if answer is None else float(answer)
        yield from book.opening(None if self.mass_kg else self.length_mm)
        place = Place(self.method.mountings[0], 1, True)
        held = ("load_kg", hung) if self.mass_kg else ("held_length_mm", self.length_mm)
        yield from book.begin(place, f"cycles from {first}", "fatigue", (held,))
        if not self.mass_kg:
            yield from book.tared()
            yield SetLength(self.length_mm)
        yield Zero(book.trial, "before", self.method.zero_s)
        log = CycleLog(self.kept, self.limits, first, trial)
        try:
            for number in range(first, self.cycles + 1):
                leak = self.leak.every and number % self.leak.every == 0
                reason = yield Cycle(
                    log, number, self.low_kpa, self.high_kpa, 1.0 / self.rate_hz, hung,
                    self.leak.hold_s if leak else 0.0,
                )  # fmt: skip
                if reason:
                    break
        finally:
            log.close()
        yield LowerLoad() if self.mass_kg else Vent()
        yield from book.end()
        yield State("done")
        if self.mass_kg:
            yield HangLoad(0.0)


def done(run: Run) -> dict[str, Any]:
    """Cycles that an unfinished run made, and its trials: all count, none is made again."""
    earlier = run.manifest.get("continues") or {}
    cycles = int(earlier.get("cycles", 0))
    made = run.samples(CYCLES).get("cycle") if CYCLES in run.streams else None
    if made is not None and len(made):
        cycles = max(cycles, int(made.max()))
    trials = {int(t) for t in earlier.get("trials", [])}
    trials |= {int(e["trial"]) for e in run.events if e.get("kind") == "trial"}
    return {"cycles": cycles, "trials": sorted(trials), "trial": max(trials, default=0) + 1}


def rest(plan: Fatigue, continues: Mapping[str, Any]) -> Steps:
    """The cycles that are left."""
    return plan.part(int(continues["cycles"]) + 1, int(continues["trial"]))


def read(name: str, config: RigConfig) -> Fatigue:
    """Read a protocol file, held against the rig's limits.

    Raises:
        ConfigError: unknown key, wrong type, a value beyond the rig's limit, or a source of
            pressure that a person turns.
    """
    t = load_toml(name, "protocols")
    t.text("protocol", choices=("fatigue",))
    refuse_hand_regulator(t, config, "cycles")
    top = config.limits.pressure_kpa
    low, high = config.limits.length_min_mm, config.limits.length_max_mm
    heaviest = config.limits.force_n / config.conditions.gravity_m_s2
    mass = t.number("mass_kg", 0.0, heaviest, 0.0, unit="kg")
    keep, stop = t.table("keep", optional=True), t.table("stop", optional=True)
    leak = t.table("leak", optional=True)
    out = Fatigue(
        name=t.text("name", "fatigue"),
        length_mm=0.0 if mass else t.number("length_mm", low, high, unit="mm"),
        mass_kg=mass,
        low_kpa=t.number("low_kpa", 0.0, top, unit="kPa"),
        high_kpa=t.number("high_kpa", VENTED_KPA, top, unit="kPa"),
        rate_hz=t.number("rate_hz", 0.001, 20.0, unit="Hz"),
        cycles=t.integer("cycles", 1, 10**9),
        kept=Kept(keep.integer("first", 1, 10_000, 10), keep.integer("last", 0, 1000, 10)),
        limits=Limits(
            stop.number("drop_percent", 0.0, 99.0, 0.0),
            stop.number("leak_kpa_s", 0.0, 1000.0, 0.0, unit="kPa/s"),
            stop.number("reach_kpa", 0.0, top, 0.0, unit="kPa"),
            stop.integer("confirm", 1, 1000, 3),
        ),
        leak=LeakCycles(
            leak.integer("every", 0, 10**9, 0), leak.number("hold_s", 0.2, 600.0, 2.0, unit="s")
        ),
        air=read_air(t),
        slack_length_mm=t.number("slack_length_mm", low, high, low, unit="mm"),
        method=read_method(t, config.limits, drift_n=None if mass else 0.1),
        source=t.source,
    )
    for table in (keep, stop, leak):
        table.finish()
    if out.high_kpa - out.low_kpa < 10.0:
        raise t.fail("high_kpa", f"must be at least 10 kPa above low_kpa = {out.low_kpa:g} kPa")
    if 0.0 < out.low_kpa < VENTED_KPA:
        raise t.fail("low_kpa", f"is below {VENTED_KPA:g} kPa: no valve holds that; 0 vents")
    if mass and not (config.length_source != "camera" or config.camera.source):
        raise t.fail("mass_kg", f"needs a length, and {config.source} reads none")
    if out.limits.leak_kpa_s and not out.leak.every:
        raise t.fail("stop.leak_kpa_s", "needs [leak] every: no leak is measured", "add it")
    if len(out.method.mountings) > 1 or out.method.repeats > 1:
        raise t.fail("repeats", "a muscle is worn once: one mounting, one replicate", "set 1")
    t.finish()
    return out


PROCEDURE = Procedure(
    FATIGUE, read,
    # Cycles keep the valves busy: no leak.
    firmware={"leak_counts": 0},
    done=done, rest=rest,
    stored_points=lambda plan: plan.kept.count(plan.cycles) + plan.cycles // 100,
)  # fmt: skip
