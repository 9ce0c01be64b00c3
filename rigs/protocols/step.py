"""The step test (thesis 5.8): closed-loop schemes compared on the same steps of pressure.

Each scheme of the controller gets the same staircase of set-points; what the pressure did
is recorded at 1 kHz and judged from the record alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from analysis.findings.step import STEP
from rigs.execution.procedure import Procedure, ProtocolParameters
from rigs.protocols.parts.trials import BREATH_KPA, BREATH_S
from rigs.rigfile.acceptance import read_acceptance
from rigs.rigfile.pressure_source import PROPORTIONAL
from rigs.rigfile.toml_reader import Table, load_toml
from rigs.steps.custom_step import CustomStep, Steps
from rigs.steps.steps import EndTrial, SetLength, SetPressure, State, Trial, Vent
from rigs.steps.valve import Release

if TYPE_CHECKING:
    from rigs.rigfile.config import RigConfig
    from rigs.steps.context import StepContext

SCHEMES = ("two", "duty_in", "duty", "slide", "burst", "pwm")
REGULATOR = "reg"
"""On a bench with a proportional regulator its own loop is what the steps try."""


@dataclass(frozen=True)
class Step(ProtocolParameters):
    """Parameters of a step test, as read from its protocol file."""

    name: str
    schemes: tuple[str, ...]
    pressures_kpa: tuple[float, ...]
    step_s: float
    last_s: float
    band_percent: float
    supply_kpa: float
    length_mm: float
    repeats: int
    mounting: str
    source: str = ""
    frames: int = 0

    def steps(self) -> Steps:
        """The method: for each scheme, from vented, one set-point after another."""
        yield SetLength(self.length_mm)
        yield Breath(self.schemes[0])
        order = trial = 0
        for replicate in range(1, self.repeats + 1):
            for scheme in self.schemes:
                trial += 1
                yield State(f"{scheme}, replicate {replicate}")
                yield Trial(
                    trial, scheme, replicate, trial, self.mounting, "step",
                    (("held_length_mm", self.length_mm),),
                )  # fmt: skip
                yield Vent() if scheme == REGULATOR else Release()
                before = 0.0
                for number, pressure in enumerate(self.pressures_kpa):
                    order += 1
                    yield Response(
                        trial, replicate, order, self.mounting, scheme, before, pressure,
                        self.step_s, first=number == 0,
                    )  # fmt: skip
                    before = pressure
                yield Vent() if scheme == REGULATOR else Release()
                yield EndTrial(trial)
        yield State("done")


@dataclass(frozen=True)
class Breath(CustomStep):
    """A breath of air: moving the muscle may draw a vacuum, which an outlet need not release."""

    scheme: str
    seconds = BREATH_S

    def perform(self, runner: StepContext) -> None:
        """Command a little; the trial that follows lets it out."""
        _choose(runner, self.scheme)
        _command(runner, BREATH_KPA, self.scheme)
        runner.rig.event_loop.for_seconds(BREATH_S)


def _choose(runner: StepContext, scheme: str) -> None:
    """Have the controller change its scheme; a regulator's source does that by itself."""
    if scheme != REGULATOR:
        runner.rig.valve.request(f"scheme {scheme}")


def _command(runner: StepContext, pressure_kpa: float, scheme: str) -> None:
    if scheme == REGULATOR:
        runner.do(SetPressure(pressure_kpa))
        return
    counts = float(runner.rig.config.calibrations["pressure_kpa"].raw(pressure_kpa))
    runner.record.event("command", device="valve", pressure_kpa=pressure_kpa, counts=counts)
    runner.watch.set_point("pressure", pressure_kpa)
    runner.rig.valve.set_point(counts)


@dataclass(frozen=True)
class Response(CustomStep):
    """One step of the set-point, and what follows it."""

    trial: int
    replicate: int
    order: int
    mounting: str
    scheme: str
    from_kpa: float
    set_pressure_kpa: float
    step_s: float
    first: bool
    points = 1

    @property
    def seconds(self) -> float:  # type: ignore[override]
        """About how long it takes."""
        return self.step_s

    def perform(self, runner: StepContext) -> None:
        """Command it and wait; a repeated step begins again at the pressure before it."""
        valve = runner.rig.valve
        take = runner.steering.take
        if self.first or take > 1:
            _choose(runner, self.scheme)
        if take > 1 and self.from_kpa > 0:
            _command(runner, self.from_kpa, self.scheme)
            runner.rig.event_loop.for_seconds(self.step_s)
        first = valve.seq_end
        asked_ns = runner.rig.clock.now_ns() - runner.record.start_ns
        _command(runner, self.set_pressure_kpa, self.scheme)
        runner.rig.event_loop.for_seconds(self.step_s)
        self._show(runner)
        more = {"take": take} if take > 1 else {}
        runner.record.event(
            "point",
            trial=self.trial, slot=f"{self.scheme} {self.from_kpa:g} to {self.set_pressure_kpa:g}",
            replicate=self.replicate, order=self.order, mounting=self.mounting,
            scheme=self.scheme, from_kpa=self.from_kpa, set_pressure_kpa=self.set_pressure_kpa,
            direction="up" if self.set_pressure_kpa > self.from_kpa else "down", settled=True,
            valve_seq=[first, valve.seq_end], asked_t_ns=asked_ns, **more,
        )  # fmt: skip
        runner.progress.done += 1 if take == 1 else 0

    def _show(self, runner: StepContext) -> None:
        """The rms error of the step's second half goes to the live view."""
        counts = runner.rig.valve.recent_counts(round(self.step_s / 2 * 1000))
        kpa = runner.rig.config.calibrations["pressure_kpa"].apply(counts)
        error = float(np.sqrt(np.mean((kpa - self.set_pressure_kpa) ** 2)))
        runner.report_result(self.set_pressure_kpa, error, self.scheme)


def read(name: str, config: RigConfig) -> Step:
    """The protocol file, held against the rig.

    Raises:
        ConfigError: names file and key.
    """
    t = load_toml(name, "protocols")
    t.text("protocol", choices=("step",))
    regulator = config.pressure_source.kind in PROPORTIONAL
    if not regulator and config.virtual is not None and config.virtual.source == "regulator":
        raise t.fail(
            "protocol",
            f"tries the valve, and on {config.source} a regulator stands in its place"
            ' (virtual.source = "regulator")',
            "use the rig virtual-thesis-loop",
        )
    top = config.limits.pressure_kpa
    low, high = config.limits.length_min_mm, config.limits.length_max_mm
    step_s = t.number("step_s", 0.3, 60, 2.0, unit="s")
    plan = Step(
        name=t.text("name", "step"),
        schemes=_schemes(t, regulator),
        pressures_kpa=t.numbers("pressures_kpa", 10, top, unit="kPa"),
        step_s=step_s,
        last_s=t.number("last_s", 0.1, step_s, min(0.5, step_s), unit="s"),
        band_percent=t.number("band_percent", 0.1, 50, 3.0),
        supply_kpa=t.number("supply_kpa", 1, 1200, unit="kPa"),
        length_mm=t.number("length_mm", low, high, unit="mm"),
        repeats=t.integer("repeats", 1, 1000, 1),
        mounting=t.text("mounting", "m1"),
        acceptance=read_acceptance(t, STEP.results),
        source=t.source,
    )
    t.finish()
    return plan


def _schemes(t: Table, regulator: bool) -> tuple[str, ...]:
    """The schemes to try; a proportional regulator has its own loop in their place."""
    named = t.texts("schemes", (*SCHEMES, REGULATOR))
    if not regulator and REGULATOR in named:
        raise t.fail("schemes", "'reg' needs a proportional regulator as pressure source")
    return (REGULATOR,) if regulator else named


PROCEDURE = Procedure(
    STEP, read,
    # Schemes that swing keep their valves busy; what they do to a valve is the test's business.
    firmware={"leak_counts": 0},
)  # fmt: skip
