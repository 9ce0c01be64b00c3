"""A rig with a second controller: opened, armed and made safe together with the first one."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass

from daq.errors import LinkLost, PamrigError
from rigs.bench.ports import Ports
from rigs.bench.pressure import SAFE_KPA, await_vented, open_pressure_source
from rigs.devices.event_loop import EventLoop
from rigs.devices.pressure.source import PressureSource
from rigs.devices.valve_controller import ValveController
from rigs.rigfile.config import RigConfig
from rigs.rigfile.tables.channel import channel_parameters
from rigs.rigfile.tables.regulator import output_parameters


@dataclass(frozen=True)
class Side:
    """One muscle of a rig: its controller, what sets its pressure, and the rig as it sees it.

    Attributes:
        name: of the controller, as in rig file and record: ``valve`` or ``valve_b``.
        config: the rig with this controller and this transducer as those of the rig.
    """

    name: str
    config: RigConfig
    valve: ValveController
    source: PressureSource


def sides_of(config: RigConfig) -> dict[str, RigConfig]:
    """The controllers of a rig file, each with the rig as it sees it."""
    second = config.side_b
    return {"valve": config} if second is None else {"valve": config, "valve_b": second}


def firmware_parameters(config: RigConfig) -> dict[str, int]:
    """What is set in the firmware before arming: the rig's own, and the limits in raw counts."""
    pressure = config.calibrations["pressure_kpa"]
    return {
        "trip": int(pressure.raw(config.limits.trip_kpa)),
        "sp_max": int(pressure.raw(config.limits.pressure_kpa)) + 1,
        **output_parameters(config.pressure_source.output, pressure),
        **channel_parameters(config.instruments.channels),
        **config.valve.parameters,
    }


def open_second(ports: Ports, event_loop: EventLoop, stack: ExitStack) -> Side | None:
    """The second controller, checked and configured; None where the rig has one only.

    ``stack`` tells it to vent on the way out.

    Raises:
        PortError, DeviceError: names device, key and remedy.
    """
    config = ports.config.side_b
    if config is None:
        return None
    valve = ValveController(
        ports.open("valve_b", config.valve), event_loop.clock, event_loop, key="valve_b"
    )
    event_loop.add(valve.poll)
    stack.callback(last_words, valve)
    valve.connect(config.valve.serial, config.valve.firmware)
    valve.configure(firmware_parameters(config))
    source = open_pressure_source(ports.seen_as(config), valve, event_loop, {})
    return Side("valve_b", config, valve, source)


def vent_both(sides: Sequence[Side], event_loop: EventLoop) -> float:
    """Vent and disarm every side, then wait until each reading confirms it.

    A side that cannot be reached keeps none of the others from venting: its own firmware vents
    when the heartbeat stays away.

    Returns:
        The highest of the pressures in kPa.

    Raises:
        PamrigError: that of the first side that could not be reached, after the others have vented.
    """
    problems: list[PamrigError] = []
    reached: list[Side] = []
    for side in sides:  # what is lost would end every wait for the others
        try:
            side.valve.poll()
        except LinkLost as error:
            event_loop.remove(side.valve.poll)
            problems.append(error)
        else:
            reached.append(side)
    for side in reached:
        side.valve.tell_stop()
    for side in list(reached):
        try:
            side.source.stop()
        except PamrigError as error:
            problems.append(error)
            reached.remove(side)
            if isinstance(error, LinkLost):
                _forget_lost(sides, event_loop)
    pressures = [await_vented(side.source, event_loop) for side in reached]
    if problems:
        found = problems[0]
        highest = max(pressures, default=0.0)
        if reached and highest < SAFE_KPA:
            names = " and ".join(side.name for side in reached)
            found = type(found)(
                found.where, f"{found.what} ({names} vented to {highest:.0f} kPa)", found.remedy
            )
        raise found
    return max(pressures)


def _forget_lost(sides: Sequence[Side], event_loop: EventLoop) -> None:
    """Read no port any more that is lost."""
    for side in sides:
        try:
            side.valve.poll()
        except LinkLost:
            event_loop.remove(side.valve.poll)


def last_words(valve: ValveController) -> None:
    """Tell a controller to vent on the way out: it would anyway without the heartbeat."""
    with contextlib.suppress(PamrigError):  # the link is gone or deaf: the deadline vents
        valve.still()
        valve.stop()
