"""The two valves of a block: what a command has to overcome before they move, and how far they do.

The kernel steps the valves; this module says the same in closed form, for planning pulses and for
checking. Delays (docs/reference/plant.md): on_ms + on_ms_per_kpa P, with P the gauge pressure
upstream of that solenoid (supply for the inlet, muscle for the outlet) when the command changes.
"""

from __future__ import annotations

import math
from typing import Literal

from plant.constants import PlantConstants

Solenoid = Literal["inlet", "outlet"]


def on_delay_s(solenoid: Solenoid, upstream_pa: float, c: PlantConstants) -> float:
    """Time in s from energising to open at gauge pressure `upstream_pa`."""
    if solenoid == "inlet":
        return max(0.0, c.inlet_on_s + c.inlet_on_s_per_pa * upstream_pa)
    return max(0.0, c.outlet_on_s + c.outlet_on_s_per_pa * upstream_pa)


def off_delay_s(solenoid: Solenoid, upstream_pa: float, c: PlantConstants) -> float:
    """Time in s from releasing to shut at gauge pressure `upstream_pa`."""
    if solenoid == "inlet":
        return max(0.0, c.inlet_off_s + c.inlet_off_s_per_pa * upstream_pa)
    return max(0.0, c.outlet_off_s + c.outlet_off_s_per_pa * upstream_pa)


def open_time_s(solenoid: Solenoid, pulse_s: float, upstream_pa: float, c: PlantConstants) -> float:
    """How long the valve is open after one command of `pulse_s` seconds at steady pressure.

    Inertial: nothing unless the command lasts strictly longer than the on-delay.
    Transport: both edges pass, later, but the closing one never before the opening one.
    """
    on_s = on_delay_s(solenoid, upstream_pa, c)
    off_s = off_delay_s(solenoid, upstream_pa, c)
    if c.delay_mode == "inertial" and pulse_s <= on_s:
        return 0.0
    return max(0.0, pulse_s + off_s - on_s)


def opening(command: float, dead_band: float) -> float:
    """Share of its conductance to which a valve opens at a command of 0 to 1.

    Shut within the dead band, in proportion beyond it. Also compiled into the kernels.
    """
    return max(command - dead_band, 0.0) / (1.0 - dead_band)


SPOOL_STEP = 0.125
"""Part of a valve's lag for which its mean opening stands."""
_ARRIVED = 1e-5


def following(now: float, goal: float, step_s: float, lag_s: float) -> tuple[float, float]:
    """Mean opening over a step, and that at its end, of a valve behind a first-order lag.

    What is left at the end counts as nothing below 1e-5. Also compiled into the kernels.
    """
    kept = math.exp(-step_s / lag_s)
    left = (now - goal) * kept
    mean = goal + (now - goal) * (1.0 - kept) * lag_s / step_s
    return mean, goal + (left if abs(left) > _ARRIVED else 0.0)


def pull_in_v(solenoid: Solenoid, upstream_pa: float, c: PlantConstants) -> float:
    """Coil voltage that opens the valve against `upstream_pa` (gauge)."""
    if solenoid == "inlet":
        return c.inlet_pull_in_v + c.inlet_pull_in_v_per_pa * upstream_pa
    return c.outlet_pull_in_v + c.outlet_pull_in_v_per_pa * upstream_pa


def drop_out_v(solenoid: Solenoid, c: PlantConstants) -> float:
    """Coil voltage below which the open valve shuts."""
    return c.inlet_drop_out_v if solenoid == "inlet" else c.outlet_drop_out_v
