"""A person on the virtual bench: takes some seconds, and is not quite exact."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from daq.clock import NS_PER_S, Clock
from rigs.devices.operator import Request

Step = Callable[[float], None]


class VirtualOperator:
    """Does what is requested, on the simulated bench.

    Args:
        clock: the bench's.
        steps: by axis, what setting it to a value does.
        reads: by axis, what a person reads there.
        rng: how exact a person is.
        spread: by axis, standard deviation of what is set or read (in the axis's unit).
        seconds: how long everything takes.

    Attributes:
        requests: all requests so far.
    """

    def __init__(
        self,
        clock: Clock,
        steps: dict[str, Step],
        reads: dict[str, Callable[[], float]],
        rng: np.random.Generator,
        spread: dict[str, float] | None = None,
        seconds: float = 5.0,
    ) -> None:
        self._clock = clock
        self._steps = steps
        self._reads = reads
        self._rng = rng
        self._spread = spread or {}
        self._seconds = seconds
        self._due_ns = 0
        self._request: Request | None = None
        self._done: str | None = None
        self.requests: list[Request] = []

    def begin(self, request: Request) -> None:
        """Take the request."""
        self.requests.append(request)
        self._request, self._done = request, None
        self._due_ns = self._clock.now_ns() + round(self._seconds * NS_PER_S)

    def answer(self) -> str | None:
        """Enter, or the number that was read: after some seconds, half of them to let it rest."""
        request, now_ns = self._request, self._clock.now_ns()
        if request is None:
            return None
        if self._done is None and now_ns >= self._due_ns - round(self._seconds / 2 * NS_PER_S):
            self._done = self.perform(request)
        if now_ns < self._due_ns:
            return None
        done, self._done, self._request = self._done, None, None
        return done

    def perform(self, request: Request) -> str:
        """Do it now; what a person would answer: nothing, or the number that was read."""
        spread = self._spread.get(request.axis, 0.0)
        error = float(self._rng.normal(0.0, spread)) if spread else 0.0
        if np.isnan(request.value):
            return f"{self._reads[request.axis]() + error:.4f}"
        value = request.value + error
        step = self._steps.get(request.axis)
        if step is not None:
            step(value)
        return ""
