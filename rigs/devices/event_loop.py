"""The event loop of a bench: let time pass, read every link, keep the air alive.

Drivers never sleep by themselves: while one waits for its reply, the others are read and
the heartbeat goes on.
"""

from __future__ import annotations

from collections.abc import Callable

from daq.clock import NS_PER_S, Clock, Deadline
from daq.link.acquisition import Acquisition
from daq.link.lateness import Lateness

LATE_S = 0.05
LATE_ROUNDS = 5
"""After a round that was so late, a deadline that has passed meanwhile lets some more follow."""


class EventLoop:
    """Runs the bench, step by step.

    Args:
        clock: real or virtual time.
        period_s: pause between two rounds of reading.
        acquisition: the process that reads the ports and beats; None where there is none.

    Attributes:
        lateness: how much later than planned each round began, on a real clock.
        late_s: that of the present round.
        asks: whether a person has a request open.
        on_request: called with each request to a person while it waits, and with "" once it is
            answered.
    """

    def __init__(
        self, clock: Clock, period_s: float, acquisition: Acquisition | None = None
    ) -> None:
        self.clock = clock
        self.period_s = period_s
        self.acquisition = acquisition
        self.lateness = Lateness()
        self.late_s = 0.0
        self.asks = False
        self._round_ns = 0
        self._polls: list[Callable[[], None]] = []
        self.on_request: list[Callable[[str], None]] = []

    def add(self, poll: Callable[[], None]) -> None:
        """Call ``poll`` in every round, in order of addition."""
        self._polls.append(poll)

    def remove(self, poll: Callable[[], None]) -> None:
        """Stop calling ``poll``; nothing happens when it is not there."""
        if poll in self._polls:
            self._polls.remove(poll)

    def step(self, seconds: float | None = None) -> None:
        """Wait one period (or ``seconds``) and poll everything once."""
        pause_s = self.period_s if seconds is None else seconds
        self.clock.sleep(pause_s)
        if not self.clock.virtual:
            self._measure(pause_s)
        for poll in self._polls:
            poll()

    def _measure(self, pause_s: float) -> None:
        """How much longer ago than a pause the last round began: what a step computed counts."""
        now_ns, last_ns = self.clock.now_ns(), self._round_ns
        self._round_ns = now_ns
        if last_ns:
            self.late_s = max(0.0, (now_ns - last_ns) / NS_PER_S - pause_s)
            self.lateness.add(self.late_s)

    def until(self, condition: Callable[[], bool], seconds: float) -> bool:
        """Run until ``condition()`` or until ``seconds`` have passed; True when it came."""
        deadline = Deadline(self.clock, seconds)
        more = LATE_ROUNDS
        while not condition():
            if deadline.expired:
                if self.late_s < LATE_S or not more:
                    return False
                more -= 1  # what came while the program had no turn is still to be read
            self.step()
        return True

    def for_seconds(self, seconds: float) -> None:
        """Run for a stretch of time."""
        self.until(lambda: False, seconds)
