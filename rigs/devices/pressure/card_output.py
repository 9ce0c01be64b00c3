"""A regulator on the analogue output of a data acquisition card, behind the controller's valves.

The controller keeps the inlet open towards the regulator and vents without it. The card's output
stays where it was set when the computer fails, so that it could not be safe by itself.
"""

from __future__ import annotations

import contextlib

from daq.errors import ConfigError, PamrigError
from rigs.devices.cards.card import Card
from rigs.devices.pressure.behind_valves import BehindValves
from rigs.devices.pressure.regulator_output import RegulatorOutput
from rigs.devices.pressure.source import PressureCommand, PressureSource, SourceParts
from rigs.rigfile.instruments import CardOutput


class CardOutputRegulator(BehindValves):
    """Set-points are volts of the card's output."""

    def __init__(self, valves: PressureSource, card: Card, output: CardOutput) -> None:
        super().__init__(valves)
        self._card = card
        self._output = output

    def command(self, pressure_kpa: float) -> PressureCommand:
        """The set-point in volts."""
        self.limits.check(pressure_kpa)
        volts = self._output.volts(pressure_kpa)
        return PressureCommand("pressure_source", pressure_kpa, {"setpoint_v": volts})

    def set_pressure(self, pressure_kpa: float) -> PressureCommand:
        """Open the inlet, then set the output."""
        command = self.command(pressure_kpa)
        self._valves.set_pressure(pressure_kpa)
        self._card.write(self._output.terminal, command.own["setpoint_v"])
        return command

    def ramp_to(self, pressure_kpa: float) -> None:
        """Set the output alone."""
        self._card.write(self._output.terminal, self._output.volts(max(pressure_kpa, 0.0)))

    def stop(self) -> None:
        """The controller vents and disarms; then the output goes to pressure 0, if it can."""
        self._valves.stop()
        with contextlib.suppress(PamrigError):
            self._card.write(self._output.terminal, self._output.volts(0.0))


def open_source(parts: SourceParts) -> PressureSource:
    """The source ``card-output`` of a rig file.

    Raises:
        ConfigError: there is no card with an output.
    """
    settings = parts.config.instruments.card
    if settings is None or settings.output is None or not isinstance(parts.card, Card):
        raise ConfigError(
            f"{parts.config.source}: pressure_source.kind",
            "'card-output' needs the table [card.output]", "add it, see docs/reference/cards.md",
        )  # fmt: skip
    valves = RegulatorOutput(parts.valve, parts.config)
    return CardOutputRegulator(valves, parts.card, settings.output)
