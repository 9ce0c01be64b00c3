"""Pneumatic ram that stops at a proximity switch (5.9, Appendix D-3 version 7).

Two-position control, but while a proximity input is on the error counts as zero: both valves
stay closed and the ram keeps its position. A switch that is on at a new set-point is ignored
until it has been off once, so that the ram can leave it; in the listing it cannot.
"""

from valvefw.schemes.scheme import HOLD_US, Scheme
from valvefw.schemes.valves import Valves


class Ram(Scheme):
    """Parameter ``ram_dead``, in 10-bit counts; proximity inputs in ``valves.prox``."""

    name = "ram"

    def start(self, values: dict[str, int]) -> None:
        self._dead = values["ram_dead"]
        self._setpoint_x16 = self._ignored = 0

    def step(self, counts: int, setpoint_x16: int, dt_us: int, valves: Valves) -> None:
        if setpoint_x16 != self._setpoint_x16:
            self._setpoint_x16 = setpoint_x16
            self._ignored = valves.prox
        self._ignored &= valves.prox
        error = (setpoint_x16 >> 6) - (counts >> 2)
        if valves.prox & ~self._ignored:
            error = 0
        valves.inlet_us = HOLD_US if error > self._dead else 0
        valves.vent_us = HOLD_US if error < -self._dead else 0
