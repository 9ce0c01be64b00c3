"""The switching-time test (thesis 5.12, Tables D-1 to D-3, Figure 5-21).

Each valve is tried by itself at a range of upstream pressures: one pulse, and 800 samples of a
sensor down the line, one every 50 us, in place of an oscilloscope. The samples go into the
record; when the air came and when it stayed away is found anew from them by the reduction.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.ma  # np.median loads it when first called: that must not be while air is on

from analysis.findings.switching import SWITCHING_TIME
from analysis.reduction.switching import (
    AIR_M_S,
    LINE_MM,
    SwitchingTimes,
    air_delay_ms,
    switching_times,
)
from daq.errors import DeviceError
from plant.constants import nominal
from plant.physics.valve import off_delay_s, on_delay_s
from rigs.execution.procedure import Procedure, ProtocolParameters
from rigs.protocols.parts.valves import VALVES, each_valve, need_supply_axis
from rigs.rigfile.acceptance import read_acceptance
from rigs.rigfile.toml_reader import load_toml
from rigs.steps.custom_step import Steps
from rigs.steps.valve import ValvePoint, capture_block

if TYPE_CHECKING:
    from rigs.rigfile.config import RigConfig
    from rigs.steps.context import StepContext

CAPTURE = {"order": "int64", "take": "int64", "k": "int64", "counts": "uint16"}


@dataclass(frozen=True)
class SwitchingTime(ProtocolParameters):
    """Parameters of a switching-time test, as read from its protocol file."""

    name: str
    valves: tuple[str, ...]
    pressures_kpa: tuple[float, ...]
    repeats: int
    order: str
    mountings: tuple[str, ...]
    supply_kpa: float
    width_us: int
    tolerance_kpa: float
    line_mm: float
    u_line_mm: float
    air_m_s: float
    u_air_m_s: float
    u_supply_kpa: float
    seed: int
    source: str = ""
    frames: int = 0

    def as_dict(self) -> dict[str, Any]:
        """Plain values for run.json."""
        return {**super().as_dict(), "result_axis": ["delay (ms)", 14.0]}

    def steps(self) -> Steps:
        """The method: at each pressure the supply or the vessel is set, then pulses follow."""
        return each_valve(self, "switching-time", CapturePoint)


@dataclass(frozen=True)
class CapturePoint(ValvePoint):
    """One pulse with its block of fast samples."""

    plan: SwitchingTime
    seconds = 4.0

    def perform(self, runner: StepContext) -> None:
        """Set the pressure, capture, record; a pulse without flow is recorded as such."""
        p = self.plan
        supply, came = self.upstream(runner, p.tolerance_kpa, p.supply_kpa)
        valve = runner.rig.valve
        first = valve.seq_end
        block = capture_block(valve, runner.rig.event_loop, self.command, p.width_us)
        runner.rig.event_loop.for_seconds(0.05)
        take = runner.steering.take
        n = len(block.counts)
        runner.record.stream("capture", CAPTURE)
        row = runner.record.rows("capture")
        runner.record.append(
            "capture",
            {
                "order": np.full(n, self.order, dtype=np.int64),
                "take": np.full(n, take, dtype=np.int64),
                "k": np.arange(n, dtype=np.int64),
                "counts": block.counts.astype(np.uint16),
            },
        )
        seen = True
        try:
            found = switching_times(block, air_delay_ms(p.line_mm, p.air_m_s))
            show_delays(runner, self.valve, self.set_pressure_kpa, found)
        except DeviceError as error:
            seen = False
            runner.watch.log(f"{self.slot} kPa: {error.what}")
        self.put(
            runner, settled=bool(came and seen), supply_kpa=supply, width_us=block.width_us,
            lead_us=block.lead_us, period_us=block.period_us,
            capture_rows=[row, row + n], valve_seq=[first, valve.seq_end],
        )  # fmt: skip


def show_delays(
    runner: StepContext, valve: str, pressure_kpa: float, found: SwitchingTimes
) -> None:
    """Both delays in the live view, beside those of the thesis's own valve (its lines)."""
    which: Literal["inlet", "outlet"] = "inlet" if valve == "inlet" else "outlet"
    thesis = (
        on_delay_s(which, pressure_kpa * 1e3, nominal()),
        off_delay_s(which, pressure_kpa * 1e3, nominal()),
    )
    measured = (found.on_ms, found.off_ms)
    for edge, value, expected in zip(("on", "off"), measured, thesis, strict=True):
        runner.report_result(pressure_kpa, value, f"{valve} {edge}")
        runner.report_result(pressure_kpa, expected * 1e3, f"{valve} {edge}, thesis")


def read(name: str, config: RigConfig) -> SwitchingTime:
    """The protocol file, held against the rig.

    Raises:
        ConfigError: names file and key.
    """
    t = load_toml(name, "protocols")
    t.text("protocol", choices=("switching-time",))
    top = config.limits.pressure_kpa
    line = t.table("line", optional=True)
    plan = SwitchingTime(
        name=t.text("name", "switching-time"),
        valves=t.texts("valves", VALVES, VALVES),
        pressures_kpa=t.numbers("pressures_kpa", 1, top, unit="kPa"),
        repeats=t.integer("repeats", 1, 1000, 3),
        order=t.text("order", "up-down", choices=("up-down", "random", "abba")),
        mountings=(t.text("mounting", "m1"),),
        supply_kpa=t.number("supply_kpa", 1, 1200, top, unit="kPa"),
        width_us=t.integer("width_us", 5, 30000, 20000),
        tolerance_kpa=t.number("tolerance_kpa", 0.5, 100, 4.0, unit="kPa"),
        line_mm=line.number("line_mm", 0, 10000, LINE_MM, unit="mm"),
        u_line_mm=line.number("u_line_mm", 0, 100, 0.5, unit="mm"),
        air_m_s=line.number("air_m_s", 1, 400, AIR_M_S, unit="m/s"),
        u_air_m_s=line.number("u_air_m_s", 0, 100, 1.0, unit="m/s"),
        u_supply_kpa=t.number("u_supply_kpa", 0, 100, 3.0, unit="kPa"),
        seed=t.integer("seed", 0, 2**63 - 1, 1),
        acceptance=read_acceptance(t, SWITCHING_TIME.results),
        source=t.source,
    )
    if plan.width_us % 5:
        raise t.fail("width_us", f"{plan.width_us} is not a multiple of 5", "the controller's step")
    need_supply_axis(t, plan.valves, config)
    line.finish()
    t.finish()
    return plan


PROCEDURE = Procedure(
    SWITCHING_TIME, read,
    firmware={"rise_ms": 300},
)  # fmt: skip
