"""What the outside sees of a run as it goes: hooks and progress."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

from rigs.steps.steps import Measure

if TYPE_CHECKING:
    from daq.record.writer import RecordWriter
    from rigs.bench.rig import Rig


@dataclass
class Watch:
    """What the outside sees of a run as it goes: hooks that may be left empty."""

    state: Callable[[str], None] = lambda text: None
    point: Callable[[Measure, float, float, float], None] = lambda point, p, f, length: None
    picture: Callable[[int, bytes, Any], None] = lambda host_ns, jpeg, gap: None
    set_point: Callable[[str, float], None] = lambda channel, value: None
    log: Callable[[str], None] = lambda text: None
    result: Callable[..., None] = lambda x, y, label, chart="points": None
    taring: Callable[[], None] = lambda: None
    tared: Callable[[], None] = lambda: None
    locked: Callable[[bool], None] = lambda on: None


@dataclass
class Progress:
    """How far a run is: points, state, and bench time as it was estimated beforehand."""

    points: int
    done: int = 0
    state: str = ""
    seconds: float = 0.0
    spent_s: float = 0.0


def time_left_s(total_s: float, spent_s: float, elapsed_s: float, virtual: bool) -> float | None:
    """Time left in s of the clock of ``elapsed_s``, or None if it is not known yet.

    Args:
        total_s, spent_s: estimated bench time of the whole procedure and of the steps done.
        elapsed_s: time since the start.
        virtual: True if bench time and the time that elapsed differ.
    """
    if spent_s > 0.02 * total_s:
        return max(0.0, total_s - spent_s) * elapsed_s / spent_s
    return None if virtual else total_s


class LiveView(Protocol):
    """What a running test feeds; it may lose anything, the test never waits for it."""

    def attach(self, rig: Rig, record: RecordWriter, watch: Watch, progress: Progress) -> None:
        """Take what the rig reads and what the run reports from now on."""
        ...

    def ended(self, outcome: str, error: BaseException | None) -> None:
        """How the run ended, and why."""
        ...

    def close(self) -> None:
        """The run has ended."""
        ...
