"""Two-position control with a differential gap (thesis 5.7.1, Figure 5-10, Appendix D-3 version 4).

As in the thesis, the error is the difference of 10-bit readings. Above the gap the inlet is
open, below it the outlet, inside it neither.
"""

from valvefw.schemes.scheme import HOLD_US, Scheme
from valvefw.schemes.valves import Valves


class TwoPosition(Scheme):
    """Parameter ``two_dead``: half of the differential gap, in 10-bit counts."""

    name = "two"

    def start(self, values: dict[str, int]) -> None:
        self._dead = values["two_dead"]

    def step(self, counts: int, setpoint_x16: int, dt_us: int, valves: Valves) -> None:
        error = (setpoint_x16 >> 6) - (counts >> 2)
        valves.inlet_us = HOLD_US if error > self._dead else 0
        valves.vent_us = HOLD_US if error < -self._dead else 0
