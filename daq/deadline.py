"""A deadline that a chain of calls shares, instead of one time-out per call."""

from __future__ import annotations

from daq.clock import NS_PER_S, Clock


class Deadline:
    """A point in time ``seconds`` after construction, on the given clock."""

    def __init__(self, clock: Clock, seconds: float) -> None:
        self._clock = clock
        self.seconds = seconds
        self._end_ns = clock.now_ns() + round(seconds * NS_PER_S)

    @property
    def left_s(self) -> float:
        """Remaining time, s, never negative."""
        return max(0, self._end_ns - self._clock.now_ns()) / NS_PER_S

    @property
    def expired(self) -> bool:
        """True once the deadline has passed."""
        return self._clock.now_ns() >= self._end_ns
