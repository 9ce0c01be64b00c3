"""Opens what a rig file names beside valve, balance, stage and camera."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import ExitStack
from typing import TYPE_CHECKING

import numpy as np

from analysis.reduction.pictures import measure_stored
from daq.clock import Clock
from daq.errors import ConfigError, DeviceError, PamrigError
from daq.link.acquisition import Acquisition
from daq.link.transport import Link, SerialLink
from rigs.devices.camera import Camera
from rigs.devices.cards.card import Card
from rigs.devices.cards.opened import backend
from rigs.devices.event_loop import EventLoop
from rigs.devices.fresh_camera import FreshCamera
from rigs.devices.hung_mass import HungMass
from rigs.devices.instruments.channel import ChannelReader
from rigs.devices.instruments.marks import MarkReader
from rigs.devices.instruments.modbus import ModbusInstrument
from rigs.devices.instruments.supply import Supply
from rigs.devices.instruments.text import TextInstrument
from rigs.devices.interfaces import Instrument
from rigs.devices.operator import ConsoleOperator, ManualAxis, ManualStage, Operator
from rigs.devices.operator_port import RemoteOperator
from rigs.devices.valve_controller import ValveController
from rigs.rigfile.config import Device, RigConfig, camera_values
from rigs.rigfile.instruments import CardChannel, TextDevice
from rigs.rigfile.tables.channel import ControllerChannel
from rigs.rigfile.tables.marks import MarkDevice

if TYPE_CHECKING:
    from rigs.virtual.bench import VirtualBench

CHECK_READINGS = 3
CHECK_FRAMES = 3
TERMINAL = "terminal"
"""Address of the person at the terminal."""


class Ports:
    """Where links come from: serial ports, or the virtual bench of this process.

    Args:
        config: for messages.
        clock: stamps what comes.
        stack: closes what was opened.
        bench: the virtual bench, or None.
        acquisition: the process that reads the ports, or None.
    """

    def __init__(
        self,
        config: RigConfig,
        clock: Clock,
        stack: ExitStack,
        bench: VirtualBench | None = None,
        acquisition: Acquisition | None = None,
    ) -> None:
        self.config = config
        self._acquisition = acquisition
        self._clock = clock
        self._stack = stack
        self._bench = bench
        self.card: Card | None = None

    def open_card(self, event_loop: EventLoop) -> Card | None:
        """The data acquisition card, scanning; None where the rig file names none.

        Raises:
            ConfigError, DeviceError: no package, no card, or another one.
        """
        device = self.config.instruments.card
        if device is None:
            return None
        library = self._bench.extras.card_library if self._bench is not None else None
        if library is None and device.port.startswith("tcp:"):  # that of `pamrig virtual`
            from rigs.virtual.card_port import RemoteCard
            from rigs.virtual.emulators.cards import library_of

            remote = RemoteCard(device)
            self._stack.callback(remote.close)
            library = library_of(remote)
        self.card = Card(backend(device, self._clock, library), device, event_loop)
        self._stack.callback(self.card.close)
        return self.card

    def seen_as(self, config: RigConfig) -> Ports:
        """The same ports for another view of the rig file."""
        return Ports(config, self._clock, self._stack, self._bench, self._acquisition)

    def open(self, name: str, device: Device) -> Link:
        """Open a device's port.

        Raises:
            PortError: names the key that the port came from.
        """
        if self._bench is not None:
            return self._bench.links[name]
        link = self._serial(name, device)
        self._stack.callback(link.close)
        return link

    def reopener(self, name: str, device: Device) -> Callable[[], Link]:
        """What opens the port again after it was lost."""

        def reopen() -> Link:
            if self._bench is not None:
                return self._bench.reopen(name)
            return self.open(name, device)

        return reopen

    def person(self, address: str) -> RemoteOperator:
        """A simulated person at an address."""
        person = RemoteOperator(address, f"operator ({self.config.source}: operator.port)")
        self._stack.callback(person.close)
        return person

    def _serial(self, name: str, device: Device) -> SerialLink:
        try:
            return SerialLink(device.port, device.baud, self._clock, acquisition=self._acquisition)
        except PamrigError as error:
            where = f"{name} ({self.config.source}: {name}.port = {device.port!r})"
            raise type(error)(where, error.what, error.remedy) from None


def open_supply(
    ports: Ports, event_loop: EventLoop, identities: dict[str, dict[str, str]]
) -> Supply | None:
    """The bench supply, checked, with the solenoids at their normal voltage; None without one."""
    device = ports.config.instruments.supply
    if device is None:
        return None
    supply = Supply(
        ports.open("supply", device),
        event_loop,
        device.voltage_v,
        device.max_v,
        form=device.form,
        reopen=ports.reopener("supply", device),
    )
    event_loop.add(supply.poll)
    identities["supply"] = supply.connect(device.serial)
    supply.safe()
    return supply


def open_readers(
    ports: Ports, event_loop: EventLoop, valve: ValveController, camera: FreshCamera
) -> dict[str, Instrument]:
    """Every instrument that gives readings, opened but not yet checked.

    The sources of force, length and pressure may not come back by themselves when their link was
    lost: a test cannot do without them, and what a load cell reads after it was without power is
    another zero.
    """
    config = ports.config
    card = ports.open_card(event_loop)
    out: dict[str, Instrument] = {}
    for name, channel in card.readers.items() if card is not None else ():
        out[name] = channel
    for name, device in config.instruments.readers().items():
        if isinstance(device, CardChannel):
            continue
        if isinstance(device, ControllerChannel):
            out[name] = reader = ChannelReader(valve, event_loop, name, device)
            event_loop.add(reader.poll)
            continue
        if isinstance(device, MarkDevice):
            out[name] = marks = MarkReader(
                camera, event_loop, name, device, camera_values(config),
                config.camera.jpeg_quality,
            )  # fmt: skip
            event_loop.add(marks.poll)
            continue
        link = ports.open(name, device)
        sources = (config.force_source, config.length_source, config.pressure_source.sensor)
        needed = name in sources
        needed = needed or (config.joint is not None and name in config.joint.instruments)
        reopen = None if needed else ports.reopener(name, device)
        if isinstance(device, TextDevice):
            out[name] = TextInstrument(
                link, event_loop, name, device.form,
                rate_hz=device.rate_hz, calibration=device.calibration, reopen=reopen,
            )  # fmt: skip
        else:
            out[name] = ModbusInstrument(
                link, event_loop, name, device.form,
                baud=device.baud, calibration=device.calibration, reopen=reopen,
            )  # fmt: skip
    return out


def default_operator(ports: Ports, bench: VirtualBench | None) -> Operator:
    """The person at the terminal, or a simulated one on a virtual bench.

    With "terminal" for its address the person at the terminal works on the virtual bench, too.

    Raises:
        PortError: nobody answers at the address of ``[operator]``.
    """
    address = ports.config.instruments.operator
    if address not in ("", TERMINAL):
        return ports.person(address)
    simulated = bench.extras.operator() if bench is not None else None
    if address == TERMINAL and simulated is not None:
        from rigs.virtual.emulators.hands_on import HandsOn

        return HandsOn(simulated)
    return simulated or ConsoleOperator()


def camera_length(config: RigConfig, camera: Camera) -> float:
    """Length by the camera in mm, mean of some frames.

    Raises:
        DeviceError: no trusted length in any of them.
    """
    how = camera_values(config)
    gaps = [measure_stored(camera.trigger().gray, how) for _ in range(CHECK_FRAMES)]
    pixels = [g.pixels for g in gaps if g.trusted]
    if not pixels:
        raise DeviceError("camera", f"no length: {gaps[-1].reason}", "check marks, light and lens")
    return float(config.calibrations["length_mm"].apply(np.mean(pixels)))


def manual_stage(
    config: RigConfig,
    person: Operator,
    event_loop: EventLoop,
    camera: Camera,
    reader: Instrument | None = None,
) -> ManualStage:
    """A length set by hand and looked after by the camera, or by the instrument that reads it."""
    check = (lambda: camera_length(config, camera)) if reader is None else _mean_of(reader)
    axis = ManualAxis(
        "length", "mm", person, event_loop,
        check=check, checked_by=config.length_source,
        tolerance=config.stage.tolerance_mm,
    )  # fmt: skip
    return ManualStage(axis)


def most_kg(config: RigConfig) -> float:
    """The mass that pulls with the rig's limit of force."""
    return config.limits.force_n / config.conditions.gravity_m_s2


def open_axes(
    config: RigConfig,
    person: Operator,
    event_loop: EventLoop,
    instruments: dict[str, Instrument],
    pressure_kpa: Callable[[], float],
) -> dict[str, ManualAxis]:
    """The axes of [manual]: each with the sensor that looks after it.

    Raises:
        ConfigError: ``check`` names no sensor of this rig.
    """
    out = {}
    for name, axis in config.instruments.manual.items():
        check: Callable[[], float] | None = None
        before: Callable[[], None] | None = None
        highest = most_kg(config) if name == "mass" else math.inf
        if axis.check == "pressure":
            check = pressure_kpa
        elif axis.check in instruments:
            reader = instruments[axis.check]
            check = _mean_of(reader)
            if name == "mass" and reader.quantity == "force_n":
                check = hung = HungMass(reader, config.conditions.gravity_m_s2)
                before = hung.look
        elif axis.check:
            raise ConfigError(
                f"{config.source}: manual.{name}.check",
                f"{axis.check!r} is not a sensor of this rig",
                f"one of: pressure, {', '.join(instruments)}; leave it out to believe the operator",
            )
        out[name] = ManualAxis(
            name, axis.unit, person, event_loop,
            check=check, checked_by=axis.check, tolerance=axis.tolerance,
            marked=name == "mass", before=before, highest=highest,
        )  # fmt: skip
    return out


def _mean_of(reader: Instrument) -> Callable[[], float]:
    return lambda: reader.next_mean(CHECK_READINGS)
