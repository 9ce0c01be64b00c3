"""The event loop of a bench: let time pass, read every link, keep the air alive.

Drivers never sleep by themselves: while one waits for its reply, the others are read and
the heartbeat goes on.
"""

from __future__ import annotations

from collections.abc import Callable

from daq.clock import Clock, Deadline


class EventLoop:
    """Runs the bench, step by step.

    Args:
        clock: real or virtual time.
        period_s: pause between two rounds of reading.
    """

    def __init__(self, clock: Clock, period_s: float) -> None:
        self.clock = clock
        self.period_s = period_s
        self._polls: list[Callable[[], None]] = []

    def add(self, poll: Callable[[], None]) -> None:
        """Call ``poll`` in every round, in order of addition."""
        self._polls.append(poll)

    def remove(self, poll: Callable[[], None]) -> None:
        """Stop calling ``poll``; nothing happens when it is not there."""
        if poll in self._polls:
            self._polls.remove(poll)

    def step(self, seconds: float | None = None) -> None:
        """Wait one period (or ``seconds``) and poll everything once."""
        self.clock.sleep(self.period_s if seconds is None else seconds)
        for poll in self._polls:
            poll()

    def until(self, condition: Callable[[], bool], seconds: float) -> bool:
        """Run until ``condition()`` or until ``seconds`` have passed; True when it came."""
        deadline = Deadline(self.clock, seconds)
        while not condition():
            if deadline.expired:
                return False
            self.step()
        return True

    def for_seconds(self, seconds: float) -> None:
        """Run for a stretch of time."""
        self.until(lambda: False, seconds)
