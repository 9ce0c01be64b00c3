"""A proportional regulator with an analogue input (Festo VPPM and VEAB, SMC ITV) on the controller.

The controller's output goes through a conditioner (an amplifier or a current source) to the
regulator. The rig file states signal, pressure range and conditioner. From them follows how the
firmware turns a set-point in transducer counts into counts of its output (`out_scale`,
`out_zero_x16`; `rigs.rigfile.tables.regulator.output_parameters`), so that trip and highest
set-point keep their meaning. The controller vents and holds by its valves, and takes its output
back to count 0 when it does.
"""

from __future__ import annotations

from rigs.devices.pressure.regulator_output import RegulatorOutput
from rigs.devices.pressure.source import PressureSource, SourceParts
from rigs.devices.valve_controller import ValveController
from rigs.rigfile.config import RigConfig


class AnalogueRegulator(RegulatorOutput):
    """The controller under its scheme ``reg``, its output scaled to the regulator's input.

    Args:
        valve: the controller.
        config: calibration, limit and output.
    """

    def __init__(self, valve: ValveController, config: RigConfig) -> None:
        super().__init__(valve, config)
        self.accuracy_kpa = config.pressure_source.accuracy_kpa


def open_source(parts: SourceParts) -> PressureSource:
    """The source ``analogue-regulator`` of a rig file."""
    return AnalogueRegulator(parts.valve, parts.config)
