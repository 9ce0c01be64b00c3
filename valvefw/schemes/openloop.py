"""Open loop: both valves closed, except for pulses requested by the host."""

from valvefw.schemes.scheme import Scheme
from valvefw.schemes.valves import Valves


class OpenLoop(Scheme):
    """A train of equal pulses on one valve; each starts on a tick."""

    name = "open"

    def start(self, values: dict[str, int]) -> None:
        self._inlet = False
        self._width_us = self._period_us = self._left = self._wait = 0

    def busy(self) -> bool:
        """True until the last pulse and its period are over."""
        return self._left > 0 or self._wait > 0

    def begin(
        self, inlet: bool, width_us: int, count: int, period_us: int, lead_us: int = 0
    ) -> None:
        """Start a train after ``lead_us``; the caller has checked the limits."""
        self._inlet = inlet
        self._width_us = width_us
        self._period_us = period_us
        self._left = count
        self._wait = lead_us

    def step(self, counts: int, setpoint_x16: int, dt_us: int, valves: Valves) -> None:
        if self._wait > 0:
            self._wait -= dt_us
        if self._left and self._wait <= 0:
            self._left -= 1
            # Late ticks do not delay the train: the next period is shorter by the delay.
            self._wait += self._period_us
            if self._inlet:
                valves.inlet_us = self._width_us
            else:
                valves.vent_us = self._width_us
