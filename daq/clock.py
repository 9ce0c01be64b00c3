"""Time as an argument: the real clock and the virtual one behind one face.

Nothing else in the project sleeps. On the virtual clock waiting is what drives the
simulated bench, so an hour of protocol takes seconds and repeats to the bit.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Protocol

NS_PER_S = 1_000_000_000


class Clock(Protocol):
    """What acquisition and protocols need of time."""

    virtual: bool

    def now_ns(self) -> int:
        """Monotonic time in ns; its zero has no meaning."""
        ...

    def sleep(self, seconds: float) -> None:
        """Let ``seconds`` pass; on the virtual clock this advances the bench."""
        ...

    def wall_ns(self) -> int:
        """UTC since the epoch in ns, for names and provenance only."""
        ...


class RealClock:
    """The machine's monotonic clock."""

    virtual = False

    def now_ns(self) -> int:
        """Monotonic time in ns."""
        return time.monotonic_ns()

    def sleep(self, seconds: float) -> None:
        """Wait."""
        if seconds > 0:
            time.sleep(seconds)

    def wall_ns(self) -> int:
        """UTC in ns."""
        return time.time_ns()


class VirtualClock:
    """A clock that moves only when somebody waits on it.

    ``drive(until_ns)`` is called for every wait and must bring the simulated world to
    that time; several may be registered and run in order of registration.
    """

    virtual = True

    def __init__(self, start_ns: int = 0) -> None:
        self._now_ns = start_ns
        self._drivers: list[Callable[[int], None]] = []

    def on_advance(self, drive: Callable[[int], None]) -> None:
        """Register ``drive(until_ns)``, called each time the clock is to move."""
        self._drivers.append(drive)

    def now_ns(self) -> int:
        """Virtual time in ns."""
        return self._now_ns

    def set_now_ns(self, now_ns: int) -> None:
        """Move the hand while inside ``drive`` so that what happens there is stamped right."""
        if now_ns > self._now_ns:
            self._now_ns = now_ns

    def sleep(self, seconds: float) -> None:
        """Bring the simulated world and the clock forward."""
        until_ns = self._now_ns + max(0, round(seconds * NS_PER_S))
        for drive in self._drivers:
            drive(until_ns)
        self.set_now_ns(until_ns)

    def wall_ns(self) -> int:
        """UTC in ns."""
        return time.time_ns()
