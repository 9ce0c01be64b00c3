"""Real and virtual clocks behind one interface.

Only clocks sleep. On the virtual clock, a wait advances the simulated bench, so an hour of test
takes seconds and is reproducible to the bit.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Protocol

NS_PER_S = 1_000_000_000


class Clock(Protocol):
    """Time as acquisition and protocols use it."""

    virtual: bool

    def now_ns(self) -> int:
        """Monotonic time, ns, from an arbitrary origin."""
        ...

    def sleep(self, seconds: float) -> None:
        """Wait; on the virtual clock, advance the bench."""
        ...

    def wall_ns(self) -> int:
        """UTC since the epoch, ns, for names and provenance only."""
        ...


class RealClock:
    """The machine's monotonic clock."""

    virtual = False

    def now_ns(self) -> int:
        """See :class:`Clock`."""
        return time.monotonic_ns()

    def sleep(self, seconds: float) -> None:
        """See :class:`Clock`."""
        if seconds > 0:
            time.sleep(seconds)

    def wall_ns(self) -> int:
        """See :class:`Clock`."""
        return time.time_ns()


class VirtualClock:
    """A clock that advances only in :meth:`sleep`."""

    virtual = True

    def __init__(self, start_ns: int = 0) -> None:
        self._now_ns = start_ns
        self._drivers: list[Callable[[int], None]] = []

    def on_advance(self, drive: Callable[[int], None]) -> None:
        """Register ``drive(until_ns)``, which brings a simulation to that time.

        Each wait calls all drivers in order of registration.
        """
        self._drivers.append(drive)

    def now_ns(self) -> int:
        """See :class:`Clock`."""
        return self._now_ns

    def set_now_ns(self, now_ns: int) -> None:
        """Advance the time inside a driver, so that its output gets the correct time stamps."""
        if now_ns > self._now_ns:
            self._now_ns = now_ns

    def sleep(self, seconds: float) -> None:
        """See :class:`Clock`."""
        until_ns = self._now_ns + max(0, round(seconds * NS_PER_S))
        for drive in self._drivers:
            drive(until_ns)
        self.set_now_ns(until_ns)

    def wall_ns(self) -> int:
        """See :class:`Clock`."""
        return time.time_ns()


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
