"""Opens the pressure source that a rig file names, and vents it until the reading confirms it."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping

from daq.clock import Deadline
from daq.errors import PamrigError
from rigs.bench.ports import Ports
from rigs.devices.event_loop import EventLoop
from rigs.devices.instruments.supply import Supply
from rigs.devices.operator import ManualAxis
from rigs.devices.pressure.source import PressureSource, SourceParts
from rigs.devices.valve_controller import ValveController
from rigs.rigfile.pressure_source import source_module

SAFE_KPA = 10.0
VENT_S = 5.0
"""A vent is given up when the pressure has not fallen for so long,"""
VENT_LONGEST_S = 60.0
"""or after so long in all."""
VENT_LOOK_S = 1.0
FALLING_KPA = 1.0
"""From look to look a pressure that falls at all falls by more."""


def open_pressure_source(
    ports: Ports, valve: ValveController, event_loop: EventLoop, axes: Mapping[str, ManualAxis]
) -> PressureSource:
    """The pressure source of a rig file, opened and checked.

    Raises:
        PortError, DeviceError, ConfigError: names device, key and remedy.
    """
    config = ports.config
    settings = config.pressure_source
    module = source_module(settings.kind, "rigs.devices.pressure")
    parts = SourceParts(
        config, valve, event_loop, axes, lambda: ports.open("pressure_source", settings),
        ports.card,
    )  # fmt: skip
    source = module.open_source(parts)
    assert isinstance(source, PressureSource)
    return source


def vent(source: PressureSource, event_loop: EventLoop, supply: Supply | None = None) -> float:
    """Vent, disarm and wait until the pressure reading confirms it.

    It goes on for as long as the pressure falls. The solenoids' supply, where there is one, is
    switched on again at each look: without it an outlet that is shut at rest keeps the air in.

    Returns:
        The pressure in kPa when it was confirmed, or when it did not fall any more.
    """

    def feed() -> None:
        if supply is not None:
            with contextlib.suppress(PamrigError):  # the valve is commanded to vent in any case
                supply.safe()

    try:
        try:
            source.stop()
        except PamrigError:  # of any device, seen while the controller answered: once more
            source.stop()
    finally:  # a controller that does not hear vents by itself, if it can
        feed()
    return await_vented(source, event_loop, feed)


def await_vented(
    source: PressureSource, event_loop: EventLoop, each_look: Callable[[], None] = lambda: None
) -> float:
    """Wait until the reading of a source that vents confirms it, for as long as it falls.

    Returns:
        The pressure in kPa when it was confirmed, or when it did not fall any more.

    Raises:
        PamrigError: a device keeps failing, as a controller whose link is gone does.
    """
    longest, standing = (
        Deadline(event_loop.clock, VENT_LONGEST_S),
        Deadline(event_loop.clock, VENT_S),
    )
    before = source.measured_kpa
    told: set[str] = set()

    def safe() -> bool:
        """Look once more; a device that is lost meanwhile says so once and keeps nothing up."""
        try:
            return event_loop.until(lambda: source.measured_kpa < SAFE_KPA, VENT_LOOK_S)
        except PamrigError as error:
            if error.where in told:
                raise
            told.add(error.where)
            return False

    while not safe():
        now = source.measured_kpa
        if now < before - FALLING_KPA:
            standing = Deadline(event_loop.clock, VENT_S)
        if standing.expired or longest.expired:
            break
        before = now
        each_look()
    return source.measured_kpa
