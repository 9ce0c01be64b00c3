"""A motor axis: it goes at constant speed and stops where it was sent, or where it is halted."""

from __future__ import annotations

from collections.abc import Callable

from rigs.virtual.emulators.emulator import Send
from rigs.virtual.emulators.injected_fault import Wire

SetMotion = Callable[[float, float], None]
"""Called with (length_mm, rate_mm_s) when a move starts or ends."""


class Axis:
    """The mechanics under an emulated controller; it knows neither bytes nor limits.

    Args:
        set_motion: told of every start and end of a move.
        start_mm: position at power-up.

    Attributes:
        end_ns: when the present move ends, None at rest.
        rate_mm_s: signed speed now.
        target_mm: where it is sent, or was sent last.
    """

    def __init__(self, set_motion: SetMotion, start_mm: float) -> None:
        self._set_motion = set_motion
        self._at_mm = self._from_mm = self.target_mm = start_mm
        self.rate_mm_s = 0.0
        self.end_ns: int | None = None
        self._started_ns = self._now_ns = 0

    @property
    def moving(self) -> bool:
        """Whether it is on its way."""
        return self.end_ns is not None

    def where_mm(self) -> float:
        """True position now."""
        if self.end_ns is None:
            return self._at_mm
        return self._from_mm + self.rate_mm_s * (self._now_ns - self._started_ns) * 1e-9

    def move(self, target_mm: float, speed_mm_s: float) -> None:
        """Leave for a target at once."""
        self._from_mm = self.where_mm()
        distance = target_mm - self._from_mm
        if abs(distance) < 1e-9 or speed_mm_s <= 0:
            return
        self.target_mm = target_mm
        self.rate_mm_s = speed_mm_s if distance > 0 else -speed_mm_s
        self._started_ns = self._now_ns
        self.end_ns = self._now_ns + round(abs(distance) / speed_mm_s * 1e9)
        self._set_motion(self._from_mm, self.rate_mm_s)

    def halt(self) -> None:
        """Stop where it is."""
        self._at_mm = self.where_mm()
        self.end_ns, self.rate_mm_s = None, 0.0
        self._set_motion(self._at_mm, 0.0)

    def advance(self, to_ns: int) -> None:
        """Let time pass; a move that is due ends at its target exactly."""
        if self.end_ns is not None and to_ns >= self.end_ns:
            self._at_mm = self.target_mm
            self.end_ns, self.rate_mm_s = None, 0.0
            self._set_motion(self._at_mm, 0.0)
        self._now_ns = to_ns


class StageEmulator:
    """What every emulated stage is made of: an axis, its line to the host, and their time.

    Args:
        set_motion: told of every start and end of a move.
        send: takes the bytes that go to the host.
        start_mm: position at power-up.

    Attributes:
        wire: injects faults.
    """

    def __init__(self, set_motion: SetMotion, send: Send, start_mm: float) -> None:
        self._axis = Axis(set_motion, start_mm)
        self.wire = Wire(send)
        self._now_ns = 0

    @property
    def next_ns(self) -> int | None:
        """When it next has something to do."""
        times = (self._axis.end_ns, self._due_ns, self.wire.next_ns)
        return min((t for t in times if t is not None), default=None)

    @property
    def _due_ns(self) -> int | None:
        """When the controller itself next has something to do."""
        return None

    def advance(self, to_ns: int) -> None:
        """Let time pass to ``to_ns``; a move that is due ends there exactly."""
        self._axis.advance(to_ns)
        self._now_ns = to_ns
        self._work()
        self.wire.advance(to_ns)

    def _work(self) -> None:
        """What the controller does by itself now."""
