"""Steps of one protocol alone, and the type of every step a protocol may yield."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Generator
from typing import Any, ClassVar

from rigs.steps.context import StepContext
from rigs.steps.steps import (
    Dwell,
    EndTrial,
    Measure,
    SetLength,
    SetPressure,
    Settle,
    State,
    Tare,
    Trial,
    Vent,
    Zero,
)


class CustomStep(ABC):
    """A step of one protocol alone, which brings the way in which it is carried out.

    Attributes:
        points: how many points of the result it makes.
        seconds: about how long it takes.
    """

    points: ClassVar[int] = 0
    seconds: ClassVar[float] = 1.0

    @abstractmethod
    def perform(self, runner: StepContext) -> Any:
        """Do it; what is returned is the value of the protocol's ``yield``.

        A point that it makes goes into the record with ``take=runner.steering.take`` where
        that is above 1, and counts in ``runner.progress.done``.
        """


Step = (
    State | Vent | SetLength | Tare | SetPressure | Dwell | Settle | Zero | Measure
    | Trial | EndTrial | CustomStep
)  # fmt: skip
Answer = Any
"""(settled, seconds waited) of a Settle; what a CustomStep returns; None of all others."""
Steps = Generator[Step, Answer, None]
