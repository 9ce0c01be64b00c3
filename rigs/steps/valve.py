"""What the valve tests do on a bench: a supply turned, a vessel filled, both valves shut.

Every point of these tests makes its own setting, so that it can be repeated by itself. After
:func:`fill` and :func:`release` the controller is in scheme ``open`` with both valves closed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.reduction.switching import Block
from daq.errors import DeviceError
from rigs.devices.event_loop import EventLoop
from rigs.devices.valve_controller import ValveController
from rigs.steps.context import RunFault
from rigs.steps.custom_step import CustomStep

if TYPE_CHECKING:
    from rigs.rigfile.config import RigConfig
    from rigs.steps.context import StepContext

RELEASED_KPA = 2.0
LOOK = 100
"""So many of the newest pressure samples, at 1 kHz, are looked at."""
FILL_S = 40.0
RELEASE_S = 15.0
QUIET_S = 0.06


@dataclass(frozen=True)
class Release(CustomStep):
    """Let the air out, whatever scheme a test has chosen meanwhile, and shut both valves."""

    seconds = 1.0

    def perform(self, runner: StepContext) -> None:
        """See :func:`release`."""
        release(runner)


def set_supply(runner: StepContext, pressure_kpa: float) -> float:
    """Have the supply's regulator turned to a pressure, unless it is there; returns the reading.

    The reading is 0.0 on a rig without a ``[manual.supply]``.
    """
    axis = runner.rig.axes.get("supply")
    if axis is None:
        return 0.0
    if axis.settings and axis.settings[-1].asked == pressure_kpa:
        return axis.settings[-1].read
    runner.report_state(f"supply to {pressure_kpa:g} kPa")
    return axis.set(pressure_kpa).read


def has_supply_axis(config: RigConfig) -> bool:
    """Whether the rig's supply pressure can be set."""
    return "supply" in config.instruments.manual


def pressure_now(runner: StepContext, samples: int = LOOK) -> float:
    """Mean of the newest samples in kPa."""
    counts = runner.rig.valve.recent_counts(samples)
    return float(runner.rig.config.calibrations["pressure_kpa"].apply(np.mean(counts)))


def fill(
    runner: StepContext, pressure_kpa: float, tolerance_kpa: float, timeout_s: float = FILL_S
) -> bool:
    """Bring the pressure between the valves to a value and shut both; whether it got there.

    Raises:
        DeviceError: beyond the rig's limit.
    """
    limit = runner.rig.config.limits.pressure_kpa
    if pressure_kpa > limit:
        raise DeviceError(
            runner.rig.config.source,
            f"set-point {pressure_kpa:g} kPa is above limits.pressure_kpa = {limit:g} kPa",
            "correct the protocol or the limit",
        )
    valve, event_loop = runner.rig.valve, runner.rig.event_loop
    runner.watch.set_point("pressure", pressure_kpa)
    counts = float(runner.rig.config.calibrations["pressure_kpa"].raw(pressure_kpa))
    runner.record.event("command", device="valve", pressure_kpa=pressure_kpa, counts=counts)
    valve.request(f"scheme {runner.rig.config.valve.static_scheme}")
    valve.set_point(counts)
    begin = valve.seq_end

    def there() -> bool:
        near = abs(pressure_now(runner) - pressure_kpa) <= tolerance_kpa
        return near and valve.seq_end > begin + LOOK

    came = event_loop.until(there, timeout_s)
    valve.request("scheme open")
    event_loop.for_seconds(QUIET_S)
    return came


def release(runner: StepContext) -> None:
    """Let the air out and shut both valves.

    Raises:
        RunFault: the pressure does not go.
    """
    valve = runner.rig.valve
    runner.watch.set_point("pressure", 0.0)
    valve.request("vent")
    if not runner.rig.event_loop.until(lambda: pressure_now(runner, 50) < RELEASED_KPA, RELEASE_S):
        raise RunFault(
            valve.name,
            f"commanded to vent, pressure still reads {pressure_now(runner):.0f} kPa"
            f" after {RELEASE_S:g} s",
            "shut the supply by hand; check the outlet and the pressure zero",
        )
    valve.request("scheme open")
    runner.rig.event_loop.for_seconds(QUIET_S)


@dataclass(frozen=True)
class ValvePoint(CustomStep):
    """A point of a valve test: where it belongs.

    Attributes:
        valve: "inlet" or "outlet".
        set_pressure_kpa: upstream of that valve.
    """

    trial: int
    slot: str
    replicate: int
    order: int
    mounting: str
    valve: str
    set_pressure_kpa: float
    points = 1

    @property
    def command(self) -> str:
        """The valve as the controller calls it."""
        return "inlet" if self.valve == "inlet" else "vent"

    def put(self, runner: StepContext, **fields: Any) -> None:
        """The point's event in the record; it counts as done."""
        own = ("trial", "slot", "replicate", "order", "mounting", "valve", "set_pressure_kpa")
        take = {"take": runner.steering.take} if runner.steering.take > 1 else {}
        runner.record.event(
            "point", **{k: getattr(self, k) for k in own}, direction="single", **take, **fields
        )
        runner.progress.done += 1 if not take else 0

    def upstream(
        self, runner: StepContext, tolerance_kpa: float, top_kpa: float
    ) -> tuple[float, bool]:
        """Bring this valve's upstream side to its pressure: (supply as read, got there).

        The inlet's is the supply, with the vessel behind it vented; the outlet's is the vessel,
        filled from a supply of ``top_kpa``.
        """
        if self.valve == "inlet":
            supply = set_supply(runner, self.set_pressure_kpa)
            release(runner)
            return supply, True
        supply = set_supply(runner, top_kpa)
        return supply, fill(runner, self.set_pressure_kpa, tolerance_kpa)


def capture_block(
    controller: ValveController, event_loop: EventLoop, valve: str, width_us: int, source: int = 1
) -> Block:
    """One pulse on an armed controller in scheme ``open``, with the samples around it.

    Args:
        controller: the valve controller.
        event_loop: of the bench.
        valve: "inlet" or "vent".
        width_us: length of the command, at most 30000, a multiple of 5.
        source: 0 the pressure sensor, 1 the second sensor.

    Raises:
        DeviceError: refused, in the controller's words.
    """
    answer = controller.request(f"capture {valve} {width_us} {source}")
    n, period_us = int(answer["n"]), int(answer["period_us"])
    event_loop.for_seconds(n * period_us * 1e-6 + 0.02)
    samples: list[int] = []
    lead_us = 0
    while len(samples) < n:
        part = controller.request(f"block {len(samples)}")
        data = part["data"]
        samples += [int(data[k : k + 3], 16) for k in range(0, len(data), 3)]
        lead_us = int(part["lead_us"])
    return Block(valve, width_us, lead_us, period_us, np.array(samples, dtype=np.float64))
