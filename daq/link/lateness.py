"""How late a loop of the program was, over a run: the longest delay and the 99 % quantile."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

STEPS_PER_DECADE = 20
FIRST_S = 1e-6
CLASSES = 9 * STEPS_PER_DECADE


class Lateness:
    """Delays of a loop, counted in classes of 12 %, so that a run of days takes no memory.

    Attributes:
        count: number of rounds.
        max_s: longest delay.
    """

    def __init__(self) -> None:
        self.begin()

    def begin(self) -> None:
        """Count from now on."""
        self.count = 0
        self.max_s = 0.0
        self._recent_s = self._before_s = 0.0
        self._classes = [0] * (CLASSES + 1)

    def add(self, late_s: float) -> None:
        """One round was so late."""
        self.count += 1
        self.max_s = max(self.max_s, late_s)
        self._recent_s = max(self._recent_s, late_s)
        at = math.ceil(STEPS_PER_DECADE * math.log10(late_s / FIRST_S)) if late_s > FIRST_S else 0
        self._classes[min(at, CLASSES)] += 1

    def extend(self, late_s: Iterable[float]) -> None:
        """Several rounds."""
        for one in late_s:
            self.add(one)

    @property
    def recent_s(self) -> float:
        """Longest delay since the last call but one of :meth:`restart`."""
        return max(self._recent_s, self._before_s)

    def restart(self) -> None:
        """A new span of time begins."""
        self._before_s, self._recent_s = self._recent_s, 0.0

    def quantile_s(self, share: float) -> float:
        """Delay that so many of the rounds did not exceed; the upper end of its class."""
        left = math.ceil(share * self.count)
        for at, count in enumerate(self._classes):
            left -= count
            if left <= 0:
                return min(self.max_s, FIRST_S * 10 ** (at / STEPS_PER_DECADE))
        return self.max_s

    def as_dict(self) -> dict[str, Any]:
        """For the record: count, maximum and 99 % in ms."""
        return {
            "rounds": self.count,
            "max_ms": round(self.max_s * 1e3, 3),
            "p99_ms": round(self.quantile_s(0.99) * 1e3, 3),
        }
