"""Two solenoid valves and a transducer: the controller regulates by itself under a scheme."""

from __future__ import annotations

from math import nan

from rigs.devices.pressure.source import (
    PressureCommand,
    PressureLimits,
    PressureSource,
    SourceParts,
)
from rigs.devices.valve_controller import ValveController
from rigs.rigfile.config import RigConfig

MEAN_SAMPLES = 50
"""50 ms of pressure readings at 1 kHz."""


class SolenoidPressure(PressureSource):
    """The valve controller under one of its schemes (`valve.static_scheme`).

    A set-point goes to it in raw counts of the transducer, by the calibration ``pressure_kpa``.

    Args:
        valve: the controller.
        config: calibration, limit and scheme.
    """

    def __init__(self, valve: ValveController, config: RigConfig) -> None:
        self._valve = valve
        self._calibration = config.calibrations["pressure_kpa"]
        self._scheme = config.valve.static_scheme
        self._present = "vent"
        self.limits = PressureLimits(config.limits.pressure_kpa, config.source)

    @property
    def name(self) -> str:
        """The controller and its port."""
        return self._valve.name

    @property
    def identity(self) -> dict[str, str]:
        """That of the controller."""
        return self._valve.identity

    @property
    def measured_kpa(self) -> float:
        """By the controller's transducer."""
        counts = self._valve.recent_counts(MEAN_SAMPLES)
        return float(self._calibration.apply(counts.mean())) if len(counts) else nan

    @property
    def armed(self) -> bool:
        """As the newest telemetry reports."""
        return self._valve.armed

    @property
    def vented(self) -> bool:
        """Whether the present scheme is ``vent``."""
        return self._present == "vent"

    def arm(self) -> None:
        """Arm with the parameters that the controller has now."""
        self._valve.arm()

    def command(self, pressure_kpa: float) -> PressureCommand:
        """The set-point in raw counts."""
        self.limits.check(pressure_kpa)
        return PressureCommand("valve", pressure_kpa, {"counts": self._counts(pressure_kpa)})

    def set_pressure(self, pressure_kpa: float) -> PressureCommand:
        """Choose the scheme if need be, then send the set-point."""
        command = self.command(pressure_kpa)
        self._choose(self._scheme)
        self._valve.set_point(command.own["counts"])
        return command

    def ramp_to(self, pressure_kpa: float) -> None:
        """Send the set-point alone, not below 0 counts."""
        self._valve.set_point(max(self._counts(pressure_kpa), 0.0))

    def hold(self) -> None:
        """Scheme ``open``: both valves shut as long as no pulse is requested."""
        self._choose("open")

    def vent(self) -> None:
        """Scheme ``vent``."""
        self._choose("vent")

    def keep_alive(self, seconds: float) -> None:
        """Keep the heartbeat going; the firmware vents without it."""
        self._valve.progress(seconds)

    def release(self) -> None:
        """Stop the heartbeat."""
        self._valve.still()

    def stop(self) -> None:
        """The controller vents and disarms."""
        self._valve.stop()

    def _counts(self, pressure_kpa: float) -> float:
        return float(self._calibration.raw(pressure_kpa))

    def _choose(self, scheme: str) -> None:
        """Have the controller change its scheme, unless it has it already."""
        if scheme != self._present:
            self._valve.request("vent" if scheme == "vent" else f"scheme {scheme}")
            self._present = scheme


def open_source(parts: SourceParts) -> PressureSource:
    """The source ``solenoids`` of a rig file."""
    return SolenoidPressure(parts.valve, parts.config)
