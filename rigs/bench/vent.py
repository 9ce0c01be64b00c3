"""Make a bench safe by hand: vent, disarm, and say what the pressure reading says."""

from __future__ import annotations

import contextlib

from daq.errors import DeviceError, PamrigError
from rigs.bench.ports import Ports, open_supply
from rigs.bench.pressure import SAFE_KPA, open_pressure_source, vent
from rigs.bench.rig import open_valve
from rigs.devices.pressure.solenoids import SolenoidPressure
from rigs.devices.pressure.source import PressureSource
from rigs.rigfile.config import RigConfig


def vent_rig(config: RigConfig) -> float:
    """Vent a rig and confirm it by its pressure reading; returns the pressure in kPa.

    Raises:
        DeviceError: the pressure did not fall: the operator must act.
    """
    with open_valve(config) as (valve, event_loop, stack, bench):
        valve.stop()  # first of all; an outlet that is shut at rest opens once it has its supply
        ports, supply = Ports(config, event_loop.clock, stack, bench), None
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
