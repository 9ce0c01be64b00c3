"""Open loop: both valves shut but for the pulses the host asks for."""

from valvefw.schemes.scheme import Scheme
from valvefw.schemes.valves import Valves


class OpenLoop(Scheme):
    """A train of equal pulses on one valve; each begins on a tick."""

    name = "open"

    def __init__(self) -> None:
        self._inlet = False
        self._width_us = 0
        self._period_us = 0
        self._left = 0
        self._wait = 0

    def start(self, values: dict[str, int]) -> None:
        """Both shut, no train."""
        self._left = 0
        self._wait = 0

    def busy(self) -> bool:
        """True until the last pulse of the train has ended and its period is over."""
        return self._left > 0 or self._wait > 0

    def begin(
        self, inlet: bool, width_us: int, count: int, period_us: int, lead_us: int = 0
    ) -> None:
        """Start a train at the next step, or later; the caller has checked the bounds."""
        self._inlet = inlet
        self._width_us = width_us
        self._period_us = period_us
        self._left = count
        self._wait = lead_us

    def step(self, counts: int, setpoint_x16: int, dt_us: int, valves: Valves) -> None:
        """Begin the next pulse when its time has come."""
        if self._wait > 0:
            self._wait -= dt_us
        if self._left and self._wait <= 0:
            self._left -= 1
            # Late ticks do not stretch the train: the debt is carried into the next period.
            self._wait += self._period_us
            if self._inlet:
                valves.inlet_us = self._width_us
            else:
                valves.vent_us = self._width_us
