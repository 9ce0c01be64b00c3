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
    result: Callable[[float, float, str], None] = lambda x, y, label: None


@dataclass
class Progress:
    """How far a run is: points, state, and bench time as it was estimated beforehand."""

    points: int
    done: int = 0
    state: str = ""
    seconds: float = 0.0
    spent_s: float = 0.0


class LiveView(Protocol):
    """What a running test feeds; it may lose anything, the test never waits for it."""

    def attach(self, rig: Rig, record: RecordWriter, watch: Watch) -> None:
        """Take what the rig reads and what the run reports from now on."""
        ...

    def close(self) -> None:
        """The run has ended."""
        ...
