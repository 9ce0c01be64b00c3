"""Proportional pulse-width modulation of the inlet only (5.7.2, Figure 5-11, version 8).

One pass: read; if the error is above the dead zone, fill for a share of the period that is
proportional to the error and keep shut for the rest of it; if it is below, vent until the next
reading. From ``duty_full`` on the pulse saturates: the whole period, then one unit shut.
"""

from valvefw.schemes.scheme import HOLD_US, Scheme
from valvefw.schemes.valves import Valves


class InletDuty(Scheme):
    """Parameters ``duty_*``; times in units of ``duty_unit_us``, errors in 10-bit counts."""

    name = "duty_in"
    both = False

    def __init__(self) -> None:
        self._dead = 0
        self._gain = 0
        self._full = 1
        self._period = 0
        self._unit_us = 0
        self._wait_us = 0

    def start(self, values: dict[str, int]) -> None:
        """Copy ``duty_*`` and begin with a reading."""
        self._dead = values["duty_dead"]
        self._gain = values["duty_gain"]
        self._full = values["duty_full"]
        self._period = values["duty_period"]
        self._unit_us = values["duty_unit_us"]
        self._wait_us = 0

    def on_units(self, error: int) -> int:
        """Length of the pulse for the size of an error outside the dead zone."""
        if error >= self._full:
            return self._period
        return error * self._gain // self._full

    def step(self, counts: int, setpoint_x16: int, dt_us: int, valves: Valves) -> None:
        """Begin a pass when the one before is over."""
        if self._wait_us > 0:
            self._wait_us -= dt_us
            if self._wait_us > 0:
                return
        error = (setpoint_x16 >> 6) - (counts >> 2)
        valves.inlet_us = 0
        valves.vent_us = 0
        if error > self._dead:
            on = self.on_units(error)
            valves.inlet_us = on * self._unit_us
        elif error >= -self._dead:
            return
        elif self.both:
            on = self.on_units(-error)
            valves.vent_us = on * self._unit_us
        else:
            valves.vent_us = HOLD_US
            return
        off = self._period - on
        self._wait_us = (on + (off if off > 1 else 1)) * self._unit_us
