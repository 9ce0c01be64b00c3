"""Bringing the bench to a temperature: set by hand, waited for by the thermometer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from daq.clock import NS_PER_S
from daq.errors import DeviceError
from rigs.devices.operator import Request, request_enter
from rigs.steps.custom_step import CustomStep
from rigs.steps.steps import State, Vent

if TYPE_CHECKING:
    from rigs.steps.context import StepContext

READINGS = 5


@dataclass(frozen=True)
class SoakCriterion:
    """When a temperature counts as reached.

    For ``soak_s`` without a break the thermometer has been within ``tolerance_c`` of what was
    asked for, and over that time it drifted by no more than ``drift_c``; not so after
    ``timeout_s``, the test goes on all the same and says so.
    """

    soak_s: float
    tolerance_c: float
    drift_c: float
    timeout_s: float


@dataclass(frozen=True)
class SetTemperature(CustomStep):
    """Have the chamber set, wait until it has soaked through; answers (settled, waited in s)."""

    temperature_c: float
    criterion: SoakCriterion
    seconds: ClassVar[float] = 60.0

    def perform(self, runner: StepContext) -> tuple[bool, float]:
        """Ask, then watch the thermometer.

        Raises:
            DeviceError: there is no thermometer.
        """
        rig, c = runner.rig, self.criterion
        thermometer = rig.instruments.get("thermometer")
        if thermometer is None:
            raise DeviceError(
                rig.config.source, "has no [thermometer]", "see docs/reference/instruments.md"
            )
        runner.do(Vent())
        runner.do(State(f"soak at {self.temperature_c:g} °C"))
        # The thermometer's word counts when it has soaked, not when the knob has been turned.
        text = f"set the bench to {self.temperature_c:g} °C, then press Enter"
        request = Request("temperature", self.temperature_c, "°C", text)
        asked_s = request_enter(rig.operator, rig.event_loop, request)
        start_ns = begun_ns = rig.clock.now_ns()
        low = high = thermometer.mean(READINGS)

        def soaked() -> bool:
            nonlocal begun_ns, low, high
            now = thermometer.mean(READINGS)
            low, high = min(low, now), max(high, now)
            off = abs(now - self.temperature_c) > c.tolerance_c
            if off or high - low > c.drift_c:
                begun_ns, low, high = rig.clock.now_ns(), now, now
                return False
            return rig.clock.now_ns() - begun_ns >= c.soak_s * NS_PER_S

        settled = rig.event_loop.until(soaked, c.timeout_s)
        waited_s = (rig.clock.now_ns() - start_ns) / NS_PER_S
        read = thermometer.mean(READINGS)
        runner.record.event(
            "soaked", asked_c=self.temperature_c, read_c=read, settled=settled,
            waited_s=waited_s, operator_s=asked_s,
        )  # fmt: skip
        if not settled:
            runner.watch.log(f"{self.temperature_c:g} °C not reached in {c.timeout_s:g} s")
        return settled, waited_s
