"""The switching-voltage test (thesis 5.11, Table D-4, Figure 5-17).

The solenoids hang on a bench supply. For the voltage that turns a valve on, the valve is commanded
to open at ever other voltages, halving what lies between one that opened it and one that did not;
for the voltage at which it turns off, it is opened at the normal voltage, which is then lowered
while it is commanded to stay open. Whether it was open shows in the pressure.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from analysis.findings.switching import SWITCHING_VOLTAGE
from analysis.reduction.valve import open_in
from rigs.execution.procedure import Procedure, ProtocolParameters
from rigs.protocols.parts.valves import VALVES, each_valve, need_supply_axis
from rigs.rigfile.acceptance import read_acceptance
from rigs.rigfile.toml_reader import load_toml
from rigs.steps.context import RunFault
from rigs.steps.custom_step import Steps
from rigs.steps.valve import ValvePoint, pressure_now, release

if TYPE_CHECKING:
    from rigs.devices.instruments.supply import Supply
    from rigs.rigfile.config import RigConfig
    from rigs.steps.context import StepContext

ON_MS = 80
"""Length of the command while a voltage to turn on is tried."""
HOLD_MS = 500
"""And while one to turn off is tried: the voltage is lowered within it."""
TAIL = 90
"""Samples at the command's end in which the pressure must move if the valve is still open."""
LATEST_MS = HOLD_MS - TAIL - 40
"""The lowered voltage must stand by then."""
MOST_AGAIN = 6
"""So often a try is made again that came too late or of which samples were lost."""


@dataclass(frozen=True)
class SwitchingVoltage(ProtocolParameters):
    """Parameters of a switching-voltage test, as read from its protocol file."""

    name: str
    valves: tuple[str, ...]
    pressures_kpa: tuple[float, ...]
    repeats: int
    order: str
    mountings: tuple[str, ...]
    supply_kpa: float
    u_supply_kpa: float
    step_v: float
    u_supply_v: float
    tolerance_kpa: float
    limit_kpa: float
    seed: int
    source: str = ""
    frames: int = 0

    def as_dict(self) -> dict[str, Any]:
        """Plain values for run.json."""
        return {**super().as_dict(), "result_axis": ["voltage (V)", 6.0]}

    def steps(self) -> Steps:
        """The method: at each pressure both voltages of a valve."""
        return each_valve(self, "switching-voltage", VoltagePoint)


@dataclass(frozen=True)
class VoltagePoint(ValvePoint):
    """Both voltages of a valve at one pressure."""

    plan: SwitchingVoltage
    seconds = 25.0

    def perform(self, runner: StepContext) -> None:
        """Halve the interval for turning on, then that for turning off."""
        supply = runner.rig.supply
        assert supply is not None
        read_kpa, came = self.upstream(runner, self.plan.tolerance_kpa, self.plan.supply_kpa)
        try:
            on = self._halve(runner, supply, "on", 0.0, supply.voltage_v)
            off = self._halve(runner, supply, "off", 0.0, on)
            runner.report_result(self.set_pressure_kpa, on, f"{self.valve} on")
            runner.report_result(self.set_pressure_kpa, off, f"{self.valve} off")
        finally:
            supply.safe()
        self.put(runner, settled=came, supply_kpa=read_kpa)

    def _halve(
        self, runner: StepContext, supply: Supply, edge: str, shut_v: float, open_v: float
    ) -> float:
        """Both ends are tried, then the middle of what is left; returns the lowest that opened."""
        tries = 0
        for volts in (open_v, shut_v):
            self._try(runner, supply, edge, volts, tries)
            tries += 1
        while open_v - shut_v > self.plan.step_v:
            middle = round((open_v + shut_v) / 2, 3)
            if self._try(runner, supply, edge, middle, tries):
                open_v = middle
            else:
                shut_v = middle
            tries += 1
        return open_v

    def _try(
        self,
        runner: StepContext,
        supply: Supply,
        edge: str,
        volts: float,
        number: int,
        again: int = 0,
    ) -> bool:
        """One command; whether the valve was open at that voltage."""
        rig, valve = runner.rig, runner.rig.valve
        if again > MOST_AGAIN:
            raise RunFault(
                valve.name,
                f"{volts:g} V was tested {again} times and no attempt was complete",
                "check its cable and that the computer is not busy; the record says what was lost",
            )
        self._restore(runner, supply)
        missing = valve.telemetry.missing
        if edge == "on":
            supply.set_voltage(volts)
            supply_row = supply.rows
            supply.measure()
            first = valve.seq_end
            rig.event_loop.for_seconds(0.05)
            valve.request(f"pulse {self.command} {ON_MS * 1000}")
            rig.event_loop.for_seconds(ON_MS * 1e-3 + 0.08)
        else:
            first = valve.seq_end
            valve.request(f"pulse {self.command} {HOLD_MS * 1000}")
            begin_ns = rig.clock.now_ns()
            rig.event_loop.for_seconds(0.04)
            supply.set_voltage(volts)
            late = (rig.clock.now_ns() - begin_ns) / 1e6 > LATEST_MS
            supply_row = supply.rows
            rig.event_loop.for_seconds(
                max(0.0, HOLD_MS * 1e-3 - (rig.clock.now_ns() - begin_ns) * 1e-9)
            )
            supply.measure()
            rig.event_loop.for_seconds(0.05)
            if late:
                runner.record.event("late", order=self.order, edge=edge, set_v=volts)
                return self._try(runner, supply, edge, volts, number, again + 1)
        if valve.telemetry.missing > missing:  # whether it opened may lie in what was lost
            runner.record.event("lost", order=self.order, edge=edge, set_v=volts)
            return self._try(runner, supply, edge, volts, number, again + 1)
        take = runner.steering.take
        event: dict[str, Any] = {
            "order": self.order, "edge": edge, "valve": self.valve, "number": number,
            "set_v": volts, "supply_row": supply_row, "valve_seq": [first, valve.seq_end],
            "limit_kpa": self.plan.limit_kpa, "tail": TAIL,
        }  # fmt: skip
        part = _recent(runner, first)
        opened = open_in(part["kpa"], event, part)
        more = {"take": take} if take > 1 else {}
        runner.record.event("try", **event, **more, opened=opened)
        return opened

    def _restore(self, runner: StepContext, supply: Supply) -> None:
        """The valve's upstream side back to its pressure, at the solenoids' normal voltage."""
        if abs(supply.set_v - supply.voltage_v) > 1e-9:
            supply.set_voltage(supply.voltage_v)
        if self.valve == "inlet":  # each try begins anew for the controller's look at the sensor
            release(runner)
        elif abs(pressure_now(runner) - self.set_pressure_kpa) > self.plan.tolerance_kpa:
            self.upstream(runner, self.plan.tolerance_kpa, self.plan.supply_kpa)


def _recent(runner: StepContext, first: int) -> dict[str, Any]:
    """The valve's newest samples from a sequence number on."""
    rig = runner.rig
    n = rig.valve.seq_end - first
    counts = rig.valve.recent_counts(n)
    inlet, vent = rig.valve.recent_commands(n)
    kpa = rig.config.calibrations["pressure_kpa"].apply(counts)
    return {"kpa": kpa, "counts": counts, "inlet_u5": inlet, "vent_u5": vent}


def read(name: str, config: RigConfig) -> SwitchingVoltage:
    """The protocol file, held against the rig.

    Raises:
        ConfigError: names file and key.
    """
    t = load_toml(name, "protocols")
    t.text("protocol", choices=("switching-voltage",))
    top = config.limits.pressure_kpa
    if config.instruments.supply is None:
        raise t.fail(
            "protocol", f"needs a supply for the solenoids, and {config.source} has no [supply]",
            "add that table to the rig",
        )  # fmt: skip
    plan = SwitchingVoltage(
        name=t.text("name", "switching-voltage"),
        valves=t.texts("valves", VALVES, VALVES),
        pressures_kpa=t.numbers("pressures_kpa", 20, top, unit="kPa"),
        repeats=t.integer("repeats", 1, 1000, 1),
        order=t.text("order", "up-down", choices=("up-down", "random", "abba")),
        mountings=(t.text("mounting", "m1"),),
        supply_kpa=t.number("supply_kpa", 1, 1200, top, unit="kPa"),
        u_supply_kpa=t.number("u_supply_kpa", 0, 100, 3.0, unit="kPa"),
        step_v=t.number("step_v", 0.005, 5, 0.05, unit="V"),
        u_supply_v=t.number("u_supply_v", 0, 1, 0.01, unit="V"),
        tolerance_kpa=t.number("tolerance_kpa", 0.5, 100, 8.0, unit="kPa"),
        limit_kpa=t.number("limit_kpa", 0.05, 50, 1.0, unit="kPa"),
        seed=t.integer("seed", 0, 2**63 - 1, 1),
        acceptance=read_acceptance(t, SWITCHING_VOLTAGE.results),
        source=t.source,
    )
    need_supply_axis(t, plan.valves, config)
    t.finish()
    return plan


PROCEDURE = Procedure(
    SWITCHING_VOLTAGE, read,
    firmware={"rise_ms": 300},
)  # fmt: skip
