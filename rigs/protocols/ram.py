"""The ram test (thesis 5.9): move a large ram until a proximity switch triggers, and hold it there.

The controller's scheme ``ram`` does it, as the thesis's short program did: two-position control,
and both valves shut while a switch is on. A switch that is on when a new set-point comes is left
first.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from analysis.findings.ram import RAM
from daq.clock import NS_PER_S
from rigs.execution.procedure import Procedure, ProtocolParameters
from rigs.rigfile.acceptance import read_acceptance
from rigs.rigfile.toml_reader import load_toml
from rigs.steps.custom_step import CustomStep, Steps
from rigs.steps.steps import EndTrial, State, Trial
from rigs.steps.valve import Release

if TYPE_CHECKING:
    from rigs.rigfile.config import RigConfig
    from rigs.steps.context import StepContext

SWITCHES = {"A": 0x40, "B": 0x80}
"""Flags of the telemetry that carry the two proximity inputs (docs/reference/wire-format.md)."""


@dataclass(frozen=True)
class RamTest(ProtocolParameters):
    """Parameters of a ram test, as read from its protocol file."""

    name: str
    moves: tuple[str, ...]
    rise_kpa: float
    fall_kpa: float
    reach_s: float
    hold_s: float
    repeats: int
    mounting: str
    source: str = ""
    frames: int = 0

    def steps(self) -> Steps:
        """The method: from the lower end through the moves, one trial a replicate."""
        order = 0
        for replicate in range(1, self.repeats + 1):
            yield State(f"replicate {replicate}: to the lower end")
            yield Trial(replicate, "moves", replicate, replicate, self.mounting, "ram")
            yield Release()
            for number, move in enumerate(self.moves):
                order += 1
                yield State(f"replicate {replicate}: {move}")
                way, switch = move.split(" to ")
                yield Move(
                    replicate, replicate, order, self.mounting, way, switch,
                    # Each set-point differs from the one before, so that the switch is left.
                    (self.rise_kpa if way == "up" else self.fall_kpa) + 0.1 * (number % 2),
                    self.reach_s, self.hold_s, first=number == 0,
                )  # fmt: skip
            yield Release()
            yield EndTrial(replicate)
        yield State("done")


@dataclass(frozen=True)
class Move(CustomStep):
    """One move to a switch, and the hold there."""

    trial: int
    replicate: int
    order: int
    mounting: str
    way: str
    switch: str
    set_pressure_kpa: float
    reach_s: float
    hold_s: float
    first: bool
    points = 1

    @property
    def seconds(self) -> float:  # type: ignore[override]
        """About how long it takes."""
        return self.reach_s / 4 + self.hold_s

    def perform(self, runner: StepContext) -> None:
        """Ask, wait for the switch, hold."""
        valve, event_loop = runner.rig.valve, runner.rig.event_loop
        take = runner.steering.take
        if self.first:
            valve.request("scheme ram")
        counts = float(runner.rig.config.calibrations["pressure_kpa"].raw(self.set_pressure_kpa))
        first = valve.seq_end
        runner.watch.set_point("pressure", self.set_pressure_kpa)
        runner.record.event(
            "command", device="valve", pressure_kpa=self.set_pressure_kpa, counts=counts
        )
        begin_ns = runner.rig.clock.now_ns()
        valve.set_point(counts)
        flag = SWITCHES[self.switch]
        # The switch that it stands at is left first, if it is the same.
        if valve.flags & flag:
            event_loop.until(lambda: not valve.flags & flag, self.reach_s)
        reached = event_loop.until(lambda: bool(valve.flags & flag), self.reach_s)
        took_s = (runner.rig.clock.now_ns() - begin_ns) / NS_PER_S
        event_loop.for_seconds(self.hold_s)
        if reached:
            runner.report_result(runner.rig.pressure_kpa, took_s, f"{self.way} to {self.switch}")
        else:
            runner.watch.log(f"switch {self.switch} did not trigger within {self.reach_s:g} s")
        more = {"take": take} if take > 1 else {}
        runner.record.event(
            "point", trial=self.trial, slot=f"{self.way} to {self.switch}",
            replicate=self.replicate, order=self.order, mounting=self.mounting,
            direction=self.way, switch=self.switch, set_pressure_kpa=self.set_pressure_kpa,
            settled=reached, valve_seq=[first, valve.seq_end],
            asked_t_ns=begin_ns - runner.record.start_ns, **more,
        )  # fmt: skip
        runner.progress.done += 1 if take == 1 else 0


MOVES = tuple(f"{way} to {switch}" for way in ("up", "down") for switch in SWITCHES)


def read(name: str, config: RigConfig) -> RamTest:
    """The protocol file, held against the rig.

    Raises:
        ConfigError: names file and key.
    """
    t = load_toml(name, "protocols")
    t.text("protocol", choices=("ram",))
    if config.virtual is not None and config.virtual.load != "ram":
        raise t.fail(
            "protocol", f"needs a ram, and {config.source} has none (virtual.load)",
            "use the rig virtual-ram",
        )  # fmt: skip
    top = config.limits.pressure_kpa
    moves = t.raw("moves", [])
    if not isinstance(moves, list) or not moves:
        raise t.fail("moves", f"expected a list such as [{MOVES[0]!r}], got {moves!r}")
    for index, move in enumerate(moves):
        if move not in MOVES:
            raise t.fail(f"moves[{index}]", f"{move!r} is not one of {', '.join(MOVES)}")
    plan = RamTest(
        name=t.text("name", "ram"),
        moves=tuple(moves),
        rise_kpa=t.number("rise_kpa", 5, top - 2, 80.0, unit="kPa"),
        fall_kpa=t.number("fall_kpa", 0, top - 2, 5.0, unit="kPa"),
        reach_s=t.number("reach_s", 0.5, 600, 20.0, unit="s"),
        hold_s=t.number("hold_s", 0.1, 3600, 3.0, unit="s"),
        repeats=t.integer("repeats", 1, 1000, 2),
        mounting=t.text("mounting", "m1"),
        acceptance=read_acceptance(t, RAM.results),
        source=t.source,
    )
    t.finish()
    return plan


PROCEDURE = Procedure(
    RAM, read,
    firmware={"leak_counts": 0, "rise_ms": 300},
)  # fmt: skip
