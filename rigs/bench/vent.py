"""Make a bench safe by hand: vent, disarm, and say what the pressure reading says."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import TYPE_CHECKING

from daq.clock import Deadline, RealClock, VirtualClock
from daq.errors import DeviceError, PamrigError
from rigs.bench.both import sides_of
from rigs.bench.locks import RigInUse, vent_request
from rigs.bench.ports import Ports, open_supply
from rigs.bench.pressure import SAFE_KPA, open_pressure_source, vent
from rigs.bench.rig import open_valve
from rigs.devices.pressure.solenoids import SolenoidPressure
from rigs.devices.pressure.source import PressureSource
from rigs.rigfile.config import RigConfig

if TYPE_CHECKING:
    from rigs.virtual.bench import VirtualBench

TAKEN_S = 5.0
"""A running test looks for the request four times a second; nothing else takes it."""
ENDED_S = 120.0
"""A test that lowers a load before it vents may take so long."""


def vent_beside(config: RigConfig, tell: Callable[[str], None]) -> float:
    """As :func:`vent_rig`, also while a test of another program holds the rig.

    That test is asked to end, which lowers its load and vents; then the vent is confirmed here.

    Raises:
        RigInUse: the other program is not a test, or does not end.
        DeviceError: as :func:`vent_rig`.
    """
    try:
        return vent_rig(config)
    except RigInUse as error:
        used = error
    request = vent_request(config)
    request.touch()
    tell(f"{used.where} {used.what}; asked it to end and vent")
    clock = RealClock()
    taken, ended = Deadline(clock, TAKEN_S), Deadline(clock, ENDED_S)
    while not ended.expired:
        with contextlib.suppress(RigInUse):
            pressure = vent_rig(config)
            request.unlink(missing_ok=True)
            return pressure
        if request.exists() and taken.expired:
            break
        clock.sleep(0.2)
    request.unlink(missing_ok=True)
    raise RigInUse(
        used.where,
        f"{used.what}, which did not end",
        "end that program (the controller then vents by itself), or shut the supply by hand",
    )


def vent_rig(config: RigConfig) -> float:
    """Vent a rig and confirm it by its pressure reading; returns the pressure in kPa.

    A rig with a joint has two: each is vented whatever becomes of the other.

    Raises:
        DeviceError: the pressure did not fall: the operator must act.
    """
    pressures: list[float] = []
    problems: list[PamrigError] = []
    bench = None
    if config.is_virtual:
        from rigs.virtual.bench import VirtualBench

        bench = VirtualBench(config, VirtualClock())
    for name, side in sides_of(config).items():
        try:
            pressures.append(_vent_side(name, side, bench))
        except PamrigError as error:
            problems.append(error)
    if problems:
        raise problems[0]
    return max(pressures)


def _vent_side(name: str, config: RigConfig, bench: VirtualBench | None) -> float:
    """Vent the muscle behind one controller."""
    with open_valve(config, bench=bench, name=name) as (valve, event_loop, stack, bench):
        valve.stop()  # first of all; an outlet that is shut at rest opens once it has its supply
        ports, supply = Ports(config, event_loop.clock, stack, bench, event_loop.acquisition), None
        with contextlib.suppress(PamrigError):
            supply = open_supply(ports, event_loop, {})
        # A source with a port of its own may be gone: the controller's valves vent without it.
        source: PressureSource = SolenoidPressure(valve, config)
        if config.pressure_source.port:
            with contextlib.suppress(PamrigError):
                source = open_pressure_source(ports, valve, event_loop, {})
        pressure = vent(source, event_loop, supply)
        if not pressure < SAFE_KPA:
            raise DeviceError(
                valve.name,
                f"was commanded to vent, pressure still reads {pressure:.0f} kPa",
                "shut the supply by hand, open the relief, check the valve",
            )
        return pressure
