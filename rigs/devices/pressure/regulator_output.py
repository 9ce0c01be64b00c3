"""A regulator on the controller's analogue output, upstream of the inlet valve.

The controller's scheme ``reg`` keeps the inlet open and the outlet shut, and puts each set-point
on its analogue output. The regulator has a sensor of its own.
"""

from __future__ import annotations

from rigs.devices.pressure.solenoids import SolenoidPressure
from rigs.devices.pressure.source import PressureSource, SourceParts


class RegulatorOutput(SolenoidPressure):
    """The controller under its scheme ``reg``; set-points are counts of the analogue output."""

    closed_on_sensor = False


def open_source(parts: SourceParts) -> PressureSource:
    """The source ``regulator-output`` of a rig file."""
    return RegulatorOutput(parts.valve, parts.config)
