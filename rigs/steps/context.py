"""What a step may use of the test that runs it; the runner implements this."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol

from daq.errors import PamrigError
from daq.interrupt import StopFlag
from daq.record.writer import RecordWriter
from rigs.bench.rig import Rig
from rigs.devices.operator import ManualAxis
from rigs.steps.watching import Progress, Watch


class RunFault(PamrigError):
    """The bench reported a fault, or went silent, while a protocol ran."""


class Takes(Protocol):
    """What the operator requested at the present point."""

    take: int
    """1 for the first time that a point is made, 2 for its first repeat."""
    skip: bool
    """The point is to be left out."""


class StepContext(Protocol):
    """The test in which a step is carried out.

    Attributes:
        rig: open instruments.
        record: streams and events.
        stop: set from outside to end the run in good order.
        watch: hooks of the live view and the progress line.
        progress: points made, state, estimated time.
        camera: how pictures are measured, as run.json states it.
        steering: take and skip of the present point.
        load_kg: mass that hangs on the muscle.
        vented: whether the muscle is being vented.
        armed: whether the test has armed the bench.
    """

    rig: Rig
    record: RecordWriter
    stop: StopFlag
    watch: Watch
    progress: Progress
    camera: Mapping[str, Any]
    load_kg: float

    @property
    def steering(self) -> Takes:
        """Requests of the operator at the present point."""
        ...

    @property
    def vented(self) -> bool:
        """Whether the muscle is being vented."""
        ...

    @property
    def armed(self) -> bool:
        """Whether the test has armed the bench."""
        ...

    def arm(self) -> None:
        """Arm the bench."""
        ...

    def disarm(self) -> float:
        """Vent, disarm and confirm it; the pressure afterwards in kPa."""
        ...

    def do(self, step: Any) -> Any:
        """Carry out one step that makes no point; what it returns answers the protocol."""
        ...

    def make(self, step: Any) -> Any:
        """Carry out one step that makes a point."""
        ...

    def report_state(self, state: str) -> None:
        """Enter a state: record, live view and terminal."""
        ...

    def report_result(self, x: float, y: float, label: str, chart: str = "points") -> None:
        """Show a result of a valve test: record and live view."""
        ...

    def axis(self, name: str, unit: str) -> ManualAxis:
        """The manual axis of that name."""
        ...

    def shut(self) -> None:
        """Shut the air in."""
        ...

    def window(
        self, seconds: float, pictures: int = 0, take: Callable[[], object] = ...
    ) -> tuple[list[int], list[int]]:
        """Let time pass; half-open ranges of valve samples and balance rows in it."""
        ...
