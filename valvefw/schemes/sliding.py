"""Sliding mode on error and its rate (5.7.4, Figures 5-13 and 5-14, version 10).

Fill if the error is above the dead zone and the approach is slower than the limit. Vent if the
approach is faster than the limit or the error is below the dead zone. Else neither.

The rate is positive while the pressure rises, in 10-bit counts per 100 ms as in the listing.
The listing differentiates desired minus actual, which falls while the pressure rises; its
comments and the text (control of the speed of approach) require the other sign.
"""

from valvefw.schemes.scheme import HOLD_US, Scheme
from valvefw.schemes.valves import Valves

RATE_US = 100000


class Sliding(Scheme):
    """Parameters ``slide_dead``, ``slide_bound`` and ``slide_ms``, the duration of a pass."""

    name = "slide"

    def start(self, values: dict[str, int]) -> None:
        self._dead = values["slide_dead"]
        self._bound = values["slide_bound"]
        self._pass_us = values["slide_ms"] * 1000
        self._since_us = self._pass_us
        self._old = -1
        self._fill = self._vent = 0

    def step(self, counts: int, setpoint_x16: int, dt_us: int, valves: Valves) -> None:
        """Decide once per pass; keep the decision in between."""
        self._since_us += dt_us
        if self._since_us >= self._pass_us:
            # Differences of 12-bit readings: the resolution of a quarter count matters here.
            rate = 0
            if self._old >= 0:
                rate = (counts - self._old) * (RATE_US // 4) // self._since_us
            self._old = counts
            self._since_us = 0
            error = (setpoint_x16 >> 6) - (counts >> 2)
            self._fill = self._vent = 0
            if error > self._dead and rate < self._bound:
                self._fill = HOLD_US
            elif rate >= self._bound or error < -self._dead:
                self._vent = HOLD_US
        valves.inlet_us = self._fill
        valves.vent_us = self._vent
