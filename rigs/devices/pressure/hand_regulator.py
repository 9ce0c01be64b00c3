"""A regulator turned by hand (`[manual.pressure]`), behind the valves that the controller keeps."""

from __future__ import annotations

from rigs.devices.operator import ManualAxis
from rigs.devices.pressure.behind_valves import BehindValves
from rigs.devices.pressure.regulator_output import RegulatorOutput
from rigs.devices.pressure.solenoids import SolenoidPressure
from rigs.devices.pressure.source import PressureCommand, PressureSource, SourceParts


class HandRegulator(BehindValves):
    """Asks the operator for every new set-point; the axis checks, times and records it.

    Args:
        valves: the controller as a pressure source.
        axis: the manual axis ``pressure``.
    """

    def __init__(self, valves: PressureSource, axis: ManualAxis) -> None:
        super().__init__(valves)
        self._axis = axis

    def set_pressure(self, pressure_kpa: float) -> PressureCommand:
        """Open the inlet, then have the regulator turned, unless it was set to this already.

        Raises:
            DeviceError: the sensor still reads something else after three tries.
        """
        command = self._valves.set_pressure(pressure_kpa)
        settings = self._axis.settings
        if not settings or settings[-1].asked != pressure_kpa:
            self._axis.set(pressure_kpa)
        return command


def open_source(parts: SourceParts) -> PressureSource:
    """The source ``hand-regulator`` of a rig file."""
    kind = RegulatorOutput if parts.config.valve.static_scheme == "reg" else SolenoidPressure
    return HandRegulator(kind(parts.valve, parts.config), parts.axes["pressure"])
