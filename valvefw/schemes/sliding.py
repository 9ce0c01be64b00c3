"""Sliding mode on error and its rate (5.7.4, Figures 5-13 and 5-14, version 10).

Error above the dead zone and approach slower than the boundary: fill. Approach faster than the
boundary, or error below the dead zone: vent. Else neither.

The rate is that of the approach, positive while the pressure rises, in 10-bit counts per 100 ms as
in the listing. The listing differentiates desired minus actual, which falls while the pressure
rises: its comments and the text (control of the speed of approach) ask for the other sign.
"""

from valvefw.schemes.scheme import HOLD_US, Scheme
from valvefw.schemes.valves import Valves

RATE_US = 100000


class Sliding(Scheme):
    """Parameters ``slide_dead``, ``slide_bound`` and ``slide_ms``, the time of one pass."""

    name = "slide"

    def __init__(self) -> None:
        self._dead = 0
        self._bound = 0
        self._pass_us = 0
        self._since_us = 0
        self._old = -1
        self._fill = 0
        self._vent = 0

    def start(self, values: dict[str, int]) -> None:
        """Copy parameters; the first pass has no rate yet."""
        self._dead = values["slide_dead"]
        self._bound = values["slide_bound"]
        self._pass_us = values["slide_ms"] * 1000
        self._since_us = self._pass_us
        self._old = -1
        self._fill = 0
        self._vent = 0

    def step(self, counts: int, setpoint_x16: int, dt_us: int, valves: Valves) -> None:
        """Decide once a pass; hold the decision in between."""
        self._since_us += dt_us
        if self._since_us >= self._pass_us:
            # Differences of 12-bit readings: a quarter of a 10-bit count is worth having here.
            rate = 0
            if self._old >= 0:
                rate = (counts - self._old) * (RATE_US // 4) // self._since_us
            self._old = counts
            self._since_us = 0
            error = (setpoint_x16 >> 6) - (counts >> 2)
            self._fill = 0
            self._vent = 0
            if error > self._dead and rate < self._bound:
                self._fill = HOLD_US
            elif rate >= self._bound or error < -self._dead:
                self._vent = HOLD_US
        valves.inlet_us = self._fill
        valves.vent_us = self._vent
