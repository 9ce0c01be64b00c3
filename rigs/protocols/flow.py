"""The flow test (thesis 5.14, Table D-5, Figure 5-22): air velocity against pressure.

The vessel before the outlet is filled to a pressure, the outlet is opened for half a second, and
the meter in its line and the pressure sensor are read over the same stretches of time.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.findings.flow import FLOW, Meter, flow_share
from rigs.execution.procedure import Procedure, ProtocolParameters
from rigs.rigfile.acceptance import read_acceptance
from rigs.rigfile.toml_reader import load_toml
from rigs.steps.custom_step import Steps
from rigs.steps.schedule import arrange
from rigs.steps.steps import EndTrial, State, Trial
from rigs.steps.valve import ValvePoint, pressure_now

if TYPE_CHECKING:
    from rigs.rigfile.config import RigConfig
    from rigs.steps.context import StepContext

THESIS_CONDUCTANCE = 1.25e-9
"""m3/(s Pa) of a 1.0 mm orifice: what the live view draws beside the readings."""
PULSE_US = 500_000
"""The longest opening that the controller grants the outlet at a time."""


@dataclass(frozen=True)
class Flow(ProtocolParameters):
    """Parameters of a flow test, as read from its protocol file."""

    name: str
    pressures_kpa: tuple[float, ...]
    repeats: int
    order: str
    mountings: tuple[str, ...]
    supply_kpa: float
    open_ms: int
    lead_ms: float
    tolerance_kpa: float
    bore_mm: float
    u_bore_mm: float
    seed: int
    source: str = ""
    frames: int = 0

    def as_dict(self) -> dict[str, Any]:
        """Plain values for run.json."""
        return {**super().as_dict(), "result_axis": ["air velocity (m/s)", 80.0]}

    def steps(self) -> Steps:
        """The method: fill, open, read, at each pressure in turn."""
        places = arrange(self.pressures_kpa, self.order, self.repeats, self.mountings, self.seed)
        for trial, (place, pressure) in enumerate(places, start=1):
            slot = f"{pressure:g}"
            yield State(f"{pressure:g} kPa, replicate {place.replicate}")
            yield Trial(
                trial, slot, place.replicate, trial, place.mounting, "flow",
                (("held_pressure_kpa", pressure),),
            )  # fmt: skip
            yield FlowPoint(
                trial, slot, place.replicate, trial, place.mounting, "outlet", pressure, self
            )
            yield EndTrial(trial)
        yield State("done")


@dataclass(frozen=True)
class FlowPoint(ValvePoint):
    """One opening with the readings in it."""

    plan: Flow
    seconds = 5.0

    def perform(self, runner: StepContext) -> None:
        """Fill, open, read, record."""
        rig, p = runner.rig, self.plan
        _, came = self.upstream(runner, p.tolerance_kpa, p.supply_kpa)
        meter = rig.instruments["flow"]
        first, row = rig.valve.seq_end, meter.rows
        rig.valve.request(f"pulse vent {p.open_ms * 1000}")
        rig.event_loop.for_seconds(p.open_ms * 1e-3 / 2)
        kpa, speed = pressure_now(runner), meter.mean(1)
        rig.event_loop.for_seconds(p.open_ms * 1e-3 / 2 + 0.1)
        runner.report_result(kpa, speed, "measured")
        line = Meter(p.bore_mm)
        share = float(flow_share(np.array([kpa]), 0.5, line.atmosphere_kpa)[0])
        expected = THESIS_CONDUCTANCE * line.velocity_per_conductance * share
        runner.report_result(kpa, expected, "valve of the thesis")
        self.put(
            runner, settled=came, valve_seq=[first, rig.valve.seq_end],
            flow_rows=[row, meter.rows],
        )  # fmt: skip


def read(name: str, config: RigConfig) -> Flow:
    """The protocol file, held against the rig.

    Raises:
        ConfigError: names file and key.
    """
    t = load_toml(name, "protocols")
    t.text("protocol", choices=("flow",))
    top = config.limits.pressure_kpa
    meter = config.instruments.text.get("flow")
    if meter is None:
        raise t.fail(
            "protocol", f"needs an air-velocity meter, and {config.source} has no [flow]",
            "add that table to the rig",
        )  # fmt: skip
    plan = Flow(
        name=t.text("name", "flow"),
        pressures_kpa=t.numbers("pressures_kpa", 1, top, unit="kPa"),
        repeats=t.integer("repeats", 1, 1000, 2),
        order=t.text("order", "up-down", choices=("up-down", "random", "abba")),
        mountings=(t.text("mounting", "m1"),),
        supply_kpa=t.number("supply_kpa", 1, 1200, top, unit="kPa"),
        open_ms=t.integer("open_ms", 50, PULSE_US // 1000, PULSE_US // 1000),
        lead_ms=t.number("lead_ms", 0, 200, 15.0, unit="ms"),
        tolerance_kpa=t.number("tolerance_kpa", 0.5, 100, 4.0, unit="kPa"),
        bore_mm=meter.bore_mm,
        u_bore_mm=t.number("u_bore_mm", 0, 10, 0.01, unit="mm"),
        seed=t.integer("seed", 0, 2**63 - 1, 1),
        acceptance=read_acceptance(t, FLOW.results),
        source=t.source,
    )
    t.finish()
    return plan


PROCEDURE = Procedure(
    FLOW, read,
    firmware={"rise_ms": 300},
)  # fmt: skip
