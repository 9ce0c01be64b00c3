"""One deadline object passed down a call chain instead of a time-out per call."""

from __future__ import annotations

from daq.clock import NS_PER_S, Clock


class Deadline:
    """A moment by which something must have happened.

    Args:
        clock: the clock that both waits and tells the time.
        seconds: time left from now.
    """

    def __init__(self, clock: Clock, seconds: float) -> None:
        self._clock = clock
        self.seconds = seconds
        self._end_ns = clock.now_ns() + round(seconds * NS_PER_S)

    @property
    def left_s(self) -> float:
        """Seconds left, never negative."""
        return max(0, self._end_ns - self._clock.now_ns()) / NS_PER_S

    @property
    def expired(self) -> bool:
        """True once the moment has passed."""
        return self._clock.now_ns() >= self._end_ns
