"""A regulator of its own behind the two valves that the controller keeps.

The inlet stands open between regulator and muscle while there is a set-point. The controller shuts
it to hold, and shuts it and opens the outlet to vent: nobody has to turn the regulator back.
"""

from __future__ import annotations

from rigs.devices.pressure.source import PressureCommand, PressureSource


class BehindValves(PressureSource):
    """Base of such sources: everything but the set-point is the controller's.

    A subclass adds its regulator in :meth:`set_pressure` and, where a set-point may follow each
    step of a ramp, in :meth:`ramp_to`.

    Args:
        valves: the controller as a pressure source.
    """

    def __init__(self, valves: PressureSource) -> None:
        self._valves = valves
        self.limits = valves.limits
        self.closed_on_sensor = valves.closed_on_sensor

    @property
    def name(self) -> str:
        """The controller; a subclass with a device of its own names that."""
        return self._valves.name

    @property
    def identity(self) -> dict[str, str]:
        """That of the controller; a subclass with a device of its own gives that."""
        return self._valves.identity

    @property
    def measured_kpa(self) -> float:
        """By the controller's transducer."""
        return self._valves.measured_kpa

    @property
    def armed(self) -> bool:
        """Whether the controller is armed."""
        return self._valves.armed

    @property
    def vented(self) -> bool:
        """Whether the controller was commanded to vent."""
        return self._valves.vented

    def arm(self) -> None:
        """Arm the controller."""
        self._valves.arm()

    def command(self, pressure_kpa: float) -> PressureCommand:
        """As the controller is commanded."""
        return self._valves.command(pressure_kpa)

    def set_pressure(self, pressure_kpa: float) -> PressureCommand:
        """Open the inlet towards the regulator."""
        return self._valves.set_pressure(pressure_kpa)

    def ramp_to(self, pressure_kpa: float) -> None:
        """Only the controller's set-point moves."""
        self._valves.ramp_to(pressure_kpa)

    def hold(self) -> None:
        """Shut both valves."""
        self._valves.hold()

    def vent(self) -> None:
        """Shut the inlet, open the outlet."""
        self._valves.vent()

    def keep_alive(self, seconds: float) -> None:
        """For the controller's firmware."""
        self._valves.keep_alive(seconds)

    def release(self) -> None:
        """For the controller's firmware."""
        self._valves.release()

    def stop(self) -> None:
        """The controller vents and disarms."""
        self._valves.stop()
