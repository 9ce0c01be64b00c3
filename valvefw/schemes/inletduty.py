"""Proportional pulse-width modulation of the inlet only (5.7.2, Figure 5-11, version 8).

One pass: read; above the dead zone, fill for a share of the period proportional to the error
and keep closed for the rest; below it, vent until the next reading. From ``duty_full`` on the
pulse saturates: the whole period, then one unit closed.
"""

from valvefw.schemes.scheme import HOLD_US, Scheme
from valvefw.schemes.valves import Valves


class InletDuty(Scheme):
    """Parameters ``duty_*``; times in units of ``duty_unit_us``, errors in 10-bit counts."""

    name = "duty_in"
    both = False

    def start(self, values: dict[str, int]) -> None:
        self._dead = values["duty_dead"]
        self._gain = values["duty_gain"]
        self._full = values["duty_full"]
        self._period = values["duty_period"]
        self._unit_us = values["duty_unit_us"]
        self._wait_us = 0

    def on_units(self, error: int) -> int:
        """Pulse length for an error outside the dead zone."""
        if error >= self._full:
            return self._period
        return error * self._gain // self._full

    def step(self, counts: int, setpoint_x16: int, dt_us: int, valves: Valves) -> None:
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
