"""Make a bench safe by hand: vent, disarm, and say what the pressure reading says."""

from __future__ import annotations

from daq.errors import DeviceError
from rigs.config import RigConfig
from rigs.rig import SAFE_KPA, open_valve, vent


def vent_rig(config: RigConfig) -> float:
    """Vent a rig and confirm it by its pressure reading; returns the pressure in kPa.

    Raises:
        DeviceError: the pressure did not fall: the operator must act.
    """
    with open_valve(config) as (valve, pump, _, _):
        pressure = vent(valve, pump, config)
        if not pressure < SAFE_KPA:
            raise DeviceError(
                valve.name,
                f"was told to vent, pressure still reads {pressure:.0f} kPa",
                "shut the supply by hand, open the relief, check the valve",
            )
        return pressure
