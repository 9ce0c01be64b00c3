"""Which stage the gap in force comes from, while the test runs.

The pull is predicted twice: from the measured pressure, and from the pressure that the commands
alone explain. What lies between the two is carried over from valve and chamber; what lies between
the first and the measured pull is the muscle's. With two stages the exact Shapley share of the
squared gap is each one's own square and half of what they have in common (`gap.validation.shapley`
does the same for all stages once the test is over, and takes the noise out).
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from plant.arrays import Array

KEEP_S = 10.0
MEMORY_S = 120.0
MOST_WAITING = 2000
LEAST_N = 0.3
"""Root mean square of the gap below which shares say nothing."""


class LiveShare:
    """Running shares of the squared end-to-end gap, the last two minutes counting most."""

    def __init__(self) -> None:
        self._predicted: deque[tuple[float, float, float]] = deque()
        self._waiting: deque[tuple[float, float]] = deque(maxlen=MOST_WAITING)
        self._last_s: float | None = None
        self._seconds = 0.0
        self._gas = self._muscle = self._both = 0.0

    def predicted(self, time_s: float, fed_n: float, free_n: float) -> None:
        """Predicted pull at one moment: from the measured pressure, and free-running."""
        self._predicted.append((time_s, fed_n, free_n))
        while self._predicted and self._predicted[0][0] < time_s - KEEP_S:
            self._predicted.popleft()

    def measured(self, time_s: Array, force_n: Array) -> None:
        """Measured pulls; those ahead of the prediction wait for it, older ones are passed over."""
        self._waiting.extend(zip(time_s.tolist(), force_n.tolist(), strict=True))
        if len(self._predicted) < 2:
            return
        predicted = np.array(self._predicted)
        while self._waiting and self._waiting[0][0] <= predicted[-1, 0]:
            t, force = self._waiting.popleft()
            if t < predicted[0, 0]:
                continue
            fed = float(np.interp(t, predicted[:, 0], predicted[:, 1]))
            free = float(np.interp(t, predicted[:, 0], predicted[:, 2]))
            self._add(t, fed - free, force - fed)

    def _add(self, time_s: float, gas_n: float, muscle_n: float) -> None:
        if not (math.isfinite(gas_n) and math.isfinite(muscle_n)):
            return
        step = 0.0 if self._last_s is None else min(max(time_s - self._last_s, 0.0), 1.0)
        self._last_s = time_s
        fade = math.exp(-step / MEMORY_S)
        self._seconds = fade * self._seconds + step
        self._gas = fade * self._gas + step * gas_n**2
        self._muscle = fade * self._muscle + step * muscle_n**2
        self._both = fade * self._both + step * gas_n * muscle_n

    @property
    def shares(self) -> tuple[float, float] | None:
        """Shares of valve with chamber, and of the muscle; None while there is no gap to share."""
        whole = self._gas + self._muscle + 2.0 * self._both
        if self._seconds <= 0.0 or whole < LEAST_N**2 * self._seconds:
            return None
        return (self._gas + self._both) / whole, (self._muscle + self._both) / whole
