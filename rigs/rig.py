"""A rig: the opened instruments of one bench, and how it is made safe."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from math import nan
from typing import TYPE_CHECKING

from daq.clock import Clock, RealClock, VirtualClock
from daq.errors import ConfigError, PamrigError
from daq.transport import Link, SerialLink
from rigs.balance import Balance
from rigs.camera import CallCamera, Camera, open_camera
from rigs.config import Device, RigConfig
from rigs.pump import Pump
from rigs.stage import Stage
from rigs.valve import ValveController

if TYPE_CHECKING:
    from rigs.virtual.bench import VirtualBench

REAL_PERIOD_S = 0.005
VIRTUAL_PERIOD_S = 0.02
SAFE_KPA = 10.0
VENT_S = 5.0


@dataclass
class Rig:
    """The open instruments of one bench."""

    config: RigConfig
    clock: Clock
    pump: Pump
    valve: ValveController
    balance: Balance
    stage: Stage
    camera: Camera
    bench: VirtualBench | None
    identities: dict[str, dict[str, str]]

    @property
    def pressure_kpa(self) -> float:
        """Mean of the last 50 ms of pressure readings; nan before the first."""
        return pressure_kpa(self.valve, self.config)

    def vent(self) -> float:
        """Vent and confirm it; see :func:`vent`."""
        return vent(self.valve, self.pump, self.config)


def pressure_kpa(valve: ValveController, config: RigConfig) -> float:
    """Mean of the last 50 ms of pressure readings in kPa; nan before the first."""
    counts = valve.recent_counts(50)
    return float(config.calibrations["pressure_kpa"].apply(counts.mean())) if len(counts) else nan


def vent(valve: ValveController, pump: Pump, config: RigConfig, seconds: float = VENT_S) -> float:
    """Vent, disarm and wait until the pressure reading confirms it.

    Returns:
        The pressure in kPa when it was confirmed, or when the time ran out.
    """
    valve.stop()
    pump.until(lambda: pressure_kpa(valve, config) < SAFE_KPA, seconds)
    return pressure_kpa(valve, config)


def firmware_parameters(config: RigConfig) -> dict[str, int]:
    """What the firmware is told before arming: the rig's own, and the limits in raw counts."""
    pressure = config.calibrations["pressure_kpa"]
    return {
        "trip": int(pressure.raw(config.limits.trip_kpa)),
        "sp_max": int(pressure.raw(config.limits.pressure_kpa)) + 1,
        **config.valve.parameters,
    }


@contextmanager
def open_valve(
    config: RigConfig, clock: Clock | None = None
) -> Iterator[tuple[ValveController, Pump, ExitStack, VirtualBench | None]]:
    """Open the valve controller alone, check who it is; vent and close on the way out.

    On a virtual rig the whole bench is made, because its parts share one plant.

    Raises:
        PortError, DeviceError, ConfigError: names device, key and remedy.
    """
    with ExitStack() as stack:
        bench: VirtualBench | None = None
        link: Link
        if config.is_virtual:
            from rigs.virtual.bench import VirtualBench

            clock = VirtualClock() if clock is None else clock
            if not isinstance(clock, VirtualClock):
                raise ConfigError(
                    config.source,
                    "an in-process virtual rig runs on the virtual clock only",
                    "use `pamrig virtual` for real time",
                )
            bench = VirtualBench(config, clock)
            link = bench.links["valve"]
        else:
            clock = RealClock() if clock is None else clock
            link = _open_port(config, "valve", clock, stack)
        pump = Pump(clock, VIRTUAL_PERIOD_S if clock.virtual else REAL_PERIOD_S)
        valve = ValveController(link, clock, pump)
        pump.add(valve.poll)
        stack.callback(_last_words, valve)
        valve.connect(config.valve.serial, config.valve.firmware)
        yield valve, pump, stack, bench


@contextmanager
def open_rig(config: RigConfig, clock: Clock | None = None) -> Iterator[Rig]:
    """Open every instrument of a rig and check who they are; vent and close on the way out.

    Args:
        config: the rig file.
        clock: time; made to fit the rig when none is given.

    Raises:
        PortError, DeviceError, ConfigError: names device, key and remedy; whatever had been
            opened is vented and closed.
    """
    with open_valve(config, clock) as (valve, pump, stack, bench):
        clock = pump.clock
        valve.configure(firmware_parameters(config))
        camera: Camera
        if bench is not None:
            links: dict[str, Link] = dict(bench.links)
            camera = CallCamera(bench.expose, config.camera.serial)
        else:
            links = {n: _open_port(config, n, clock, stack) for n in ("balance", "stage")}
            camera = open_camera(config.camera, clock)
            stack.callback(camera.close)
        balance = Balance(links["balance"], pump)
        stage = Stage(links["stage"], pump, config.stage.speed_mm_s)
        pump.add(balance.poll)
        pump.add(stage.poll)
        identities = {
            "valve": valve.identity,
            "balance": balance.connect(config.balance.serial),
            "stage": stage.connect(config.stage.serial),
            "camera": camera.identity,
        }
        yield Rig(config, clock, pump, valve, balance, stage, camera, bench, identities)


def _open_port(config: RigConfig, name: str, clock: Clock, stack: ExitStack) -> Link:
    """Open one serial port of the rig; an error names the key it came from."""
    device: Device = getattr(config, name)
    try:
        link = SerialLink(device.port, device.baud, clock)
    except PamrigError as error:
        where = f"{name} ({config.source}: {name}.port = {device.port!r})"
        raise type(error)(where, error.what, error.remedy) from None
    stack.callback(link.close)
    return link


def _last_words(valve: ValveController) -> None:
    """Tell the valve to vent on the way out: it would anyway when the heartbeat stays away."""
    try:
        valve.still()
        valve.stop()
    except PamrigError:
        pass  # the link is gone or deaf; the heartbeat's deadline does the venting
