"""When the readings of a stream can have been made, from when they came.

An instrument makes its readings evenly. An adapter or a busy computer collects them and delivers
several at once. A reading can be late, but it is never there before it was made: that tells
readings that came together from one that was sent twice.
"""

from __future__ import annotations

from collections import deque

import numpy as np

KEEP = 48
LEARN = 32
"""So many readings are looked at before anything is judged."""
BUNCHES = 3
"""Among them so many that came together are the way of the line; fewer were sent twice."""
EARLY = 0.3
"""A reading comes at most this share of a period before its time."""
LOST = 0.7
"""One that is later than any so far by this share of a period follows a lost one."""
STOOD_STILL = 0.5
"""A period below this share of the one before: a long delivery, after the computer stood still."""
BUNCHED_MS = 5.0
"""Less than this is the jitter of any computer."""


class Arrivals:
    """Period and earliest times of a stream of readings, learned from the last of them."""

    def __init__(self) -> None:
        self._first: list[tuple[int, bool]] = []
        self._known: deque[tuple[int, int]] = deque(maxlen=KEEP)
        self._index = 0
        self._period_ns = 0.0
        self._start_ns = 0.0
        self._spread_ns = 0.0
        self._widest_ns = 0.0
        self._in_step = 0

    @property
    def learned(self) -> bool:
        """Whether enough readings have come."""
        return bool(self._known)

    @property
    def bunch_ms(self) -> int:
        """How late readings came at most, in ms; 0 for even ones.

        Their times are late by anything from 0 to this: u = bunch_ms / sqrt(12).
        """
        widest_ms = self._widest_ns * 1e-6
        return round(widest_ms) if widest_ms > BUNCHED_MS else 0

    def possible(self, host_ns: int) -> bool:
        """Whether one more reading can have been made by then."""
        if not self.learned:
            return False
        return host_ns >= self._expected_ns() - EARLY * self._period_ns

    def heard(self, host_ns: int, together: bool) -> None:
        """Any reading came, maybe together with the one before: until the stream is known."""
        if self.learned:
            return
        self._first.append((host_ns, together))
        if len(self._first) < LEARN:
            return
        if self._first[-1][0] == self._first[0][0]:  # one delivery: it holds no period
            self._first.clear()
            return
        bunches = sum(together for _, together in self._first) >= BUNCHES
        for at_ns, with_another in self._first:
            if bunches or not with_another:
                self._known.append((self._index, at_ns))
                self._index += 1
        self._first.clear()
        self._learn()

    def add(self, host_ns: int) -> None:
        """A reading that stands came at that time."""
        if not self.learned:
            return
        late_ns = host_ns - self._expected_ns() - self._spread_ns
        if late_ns > LOST * self._period_ns:
            self._index += round(late_ns / self._period_ns)
            self._in_step = 0
        self._known.append((self._index, host_ns))
        self._index += 1
        self._in_step += 1
        self._learn()
        if self._in_step > KEEP:
            self._widest_ns = max(self._widest_ns, self._spread_ns)

    def _expected_ns(self) -> float:
        return self._start_ns + self._index * self._period_ns

    def _learn(self) -> None:
        index, times = np.array(self._known, dtype=np.int64).T
        at, came = (index - index[0]).astype(np.float64), (times - times[0]).astype(np.float64)
        centred = at - at.mean()
        period_ns = float(centred @ came / (centred @ centred))
        if period_ns < STOOD_STILL * self._period_ns or period_ns <= 0.0:
            self._known.clear()  # learned again from what follows
            self._period_ns = 0.0
            return
        self._period_ns = period_ns
        behind = came - at * self._period_ns
        self._spread_ns = float(behind.max() - behind.min())
        self._start_ns = float(times[0]) + float(behind.min()) - float(index[0]) * self._period_ns
