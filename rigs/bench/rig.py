"""A rig: the opened instruments of one bench, and how it is made safe."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from daq.clock import Clock, RealClock, VirtualClock
from daq.errors import ConfigError
from daq.link.acquisition import Acquisition, available
from daq.link.transport import Link
from rigs.bench.both import Side, firmware_parameters, last_words, open_second, vent_both
from rigs.bench.locks import rig_lock
from rigs.bench.ports import (
    Ports,
    default_operator,
    manual_stage,
    open_axes,
    open_readers,
    open_supply,
)
from rigs.bench.pressure import open_pressure_source, vent
from rigs.devices.camera import CallCamera, NoCamera, open_camera
from rigs.devices.event_loop import EventLoop
from rigs.devices.fresh_camera import FreshCamera
from rigs.devices.instruments.balance import Balance, NoBalance
from rigs.devices.instruments.channel import ChannelReader
from rigs.devices.instruments.load_cell import LoadCell
from rigs.devices.instruments.supply import Supply
from rigs.devices.instruments.text import TextInstrument
from rigs.devices.interfaces import Instrument
from rigs.devices.motion.stage import MotorStage
from rigs.devices.operator import ManualAxis, ManualStage, Operator
from rigs.devices.pressure.solenoids import SolenoidPressure
from rigs.devices.pressure.source import PressureSource
from rigs.devices.valve_controller import ValveController
from rigs.rigfile.config import NONE, RigConfig
from rigs.rigfile.tables.channel import net_grams
from rigs.rigfile.tables.stage import stage_module

if TYPE_CHECKING:
    from rigs.virtual.bench import VirtualBench

REAL_PERIOD_S = 0.005
VIRTUAL_PERIOD_S = 0.02


@dataclass
class Rig:
    """The open instruments of one bench."""

    config: RigConfig
    clock: Clock
    event_loop: EventLoop
    valve: ValveController
    pressure_source: PressureSource
    balance: Balance | LoadCell | NoBalance
    stage: MotorStage | ManualStage
    camera: FreshCamera
    bench: VirtualBench | None
    identities: dict[str, dict[str, str]]
    operator: Operator
    instruments: dict[str, Instrument] = field(default_factory=dict)
    supply: Supply | None = None
    axes: dict[str, ManualAxis] = field(default_factory=dict)
    second: Side | None = None

    @property
    def sides(self) -> tuple[Side, ...]:
        """Every muscle with its controller; one, but for a rig with a joint."""
        first = Side("valve", self.config, self.valve, self.pressure_source)
        return (first,) if self.second is None else (first, self.second)

    @property
    def length_reader(self) -> Instrument | None:
        """The instrument whose reading is the length; None where the camera measures it."""
        return self.instruments.get(self.config.length_source)

    @property
    def pressure_kpa(self) -> float:
        """Mean of the last 50 ms of pressure readings; nan before the first."""
        return self.pressure_source.measured_kpa

    def vent(self) -> float:
        """Vent, disarm and confirm it; see :func:`rigs.bench.pressure.vent`.

        The solenoids get their normal voltage back. Of two muscles both are vented, whatever
        becomes of either.
        """
        if self.second is not None:
            return vent_both(self.sides, self.event_loop)
        return vent(self.pressure_source, self.event_loop, self.supply)


@contextmanager
def open_valve(
    config: RigConfig,
    clock: Clock | None = None,
    bench: VirtualBench | None = None,
    name: str = "valve",
) -> Iterator[tuple[ValveController, EventLoop, ExitStack, VirtualBench | None]]:
    """Open the valve controller alone, check who it is; vent and close on the way out.

    On a virtual rig the whole bench is made, because its parts share one plant; `bench` is one
    that is there already, as it stands after other tests. `name` is the controller's in the rig
    file, where `config` is the rig as the second one sees it (:attr:`RigConfig.side_b`).

    Raises:
        PortError, DeviceError, ConfigError: names device, key and remedy.
    """
    with ExitStack() as stack:
        link: Link
        acquisition: Acquisition | None = None
        if bench is not None:
            clock = bench.plug_in()
            link = bench.links[name]
        elif config.is_virtual:
            from rigs.virtual.bench import VirtualBench

            clock = VirtualClock() if clock is None else clock
            if not isinstance(clock, VirtualClock):
                raise ConfigError(
                    config.source,
                    "an in-process virtual rig runs on the virtual clock only",
                    "use `pamrig virtual` for real time",
                )
            bench = VirtualBench(config, clock)
            link = bench.links[name]
        else:
            clock = RealClock() if clock is None else clock
            stack.enter_context(rig_lock(config))
            if available():
                acquisition = Acquisition()
                stack.callback(acquisition.close)
            ports = Ports(config, clock, stack, acquisition=acquisition)
            link = ports.open(name, config.valve)
        period_s = VIRTUAL_PERIOD_S if clock.virtual else REAL_PERIOD_S
        event_loop = EventLoop(clock, period_s, acquisition)
        valve = ValveController(link, clock, event_loop, key=name)
        event_loop.add(valve.poll)
        stack.callback(last_words, valve)
        valve.connect(config.valve.serial, config.valve.firmware)
        yield valve, event_loop, stack, bench


def _force_source(
    ports: Ports,
    event_loop: EventLoop,
    instruments: dict[str, Instrument],
    identities: dict[str, dict[str, str]],
) -> Balance | LoadCell | NoBalance:
    """What measures the force: a balance with a port of its own, or one of the instruments."""
    config = ports.config
    if config.force_source == NONE:
        return NoBalance()
    if config.force_source == "balance":
        balance = Balance(ports.open("balance", config.balance), event_loop)
        event_loop.add(balance.poll)
        identities["balance"] = balance.connect(config.balance.serial)
        return balance
    cell = instruments[config.force_source]
    if isinstance(cell, ChannelReader):
        assert cell.calibration is not None
        return LoadCell(cell, net_grams(cell.calibration)[0])
    assert isinstance(cell, TextInstrument)
    return LoadCell(cell)


@contextmanager
def open_rig(
    config: RigConfig,
    clock: Clock | None = None,
    operator: Operator | None = None,
    bench: VirtualBench | None = None,
) -> Iterator[Rig]:
    """Open every instrument of a rig and check who they are; vent and close on the way out.

    Args:
        config: the rig file.
        clock: time; made to fit the rig when none is given.
        operator: who sets manual axes; the person at the terminal, or a simulated one on a
            virtual rig, when none is given.
        bench: a virtual bench that other tests were run on; a new one when none is given.

    Raises:
        PortError, DeviceError, ConfigError: names device, key and remedy; whatever had been
            opened is vented and closed.
    """
    with open_valve(config, clock, bench) as (valve, event_loop, stack, bench):
        clock = event_loop.clock
        valve.configure(firmware_parameters(config))
        ports = Ports(config, clock, stack, bench, event_loop.acquisition)
        identities = {"valve": valve.identity}
        second = open_second(ports, event_loop, stack)
        if second is not None:
            identities[second.name] = second.valve.identity
        supply = open_supply(ports, event_loop, identities)
        if not config.camera.source:
            camera = FreshCamera(NoCamera(), clock, False)
        elif bench is not None and not config.camera.replayed:
            eye = CallCamera(bench.expose, config.camera.serial)
            camera = FreshCamera(eye, clock, bench.camera_noise > 0.0)
        else:
            # Recorded pictures may be alike: of a single one, or of a drawing without noise.
            noisy = not config.camera.replayed
            camera = FreshCamera(open_camera(config.camera, event_loop), clock, noisy)
            stack.callback(camera.close)
        person = operator or default_operator(ports, bench)
        instruments = open_readers(ports, event_loop, valve, camera)
        balance = _force_source(ports, event_loop, instruments, identities)
        for name, reader in instruments.items():
            identities[name] = reader.connect(config.instruments.readers()[name].serial)
        stage: MotorStage | ManualStage
        if config.stage.kind == "manual":
            stage = manual_stage(
                config, person, event_loop, camera, instruments.get(config.length_source)
            )
            if config.joint is None:
                identities["stage"] = stage.identity
        else:
            module = stage_module(config.stage.kind, "rigs.devices.motion")
            stage = module.open_stage(ports.open("stage", config.stage), event_loop, config.stage)
            assert isinstance(stage, MotorStage)
            event_loop.add(stage.poll)
            identities["stage"] = stage.connect(config.stage.serial)
            length = instruments.get(config.length_source)
            if isinstance(length, ChannelReader):
                length.check_place(stage.status()[1])
        if config.camera.source:
            identities["camera"] = camera.identity
        transducer = SolenoidPressure(valve, config)
        axes = open_axes(config, person, event_loop, instruments, lambda: transducer.measured_kpa)
        source = open_pressure_source(ports, valve, event_loop, axes)
        stack.callback(source.close)
        if source.own_device is not None:
            identities["pressure_source"] = source.identity
        yield Rig(
            config, clock, event_loop, valve, source, balance, stage, camera, bench, identities,
            person, instruments, supply, axes, second,
        )  # fmt: skip
