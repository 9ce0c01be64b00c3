"""An instrument whose reading is the length of a test, in place of the camera."""

from __future__ import annotations

from typing import Any

import numpy as np

from daq.clock import NS_PER_S
from rigs.bench.rig import Rig
from rigs.devices.interfaces import Instrument
from rigs.steps.context import RunFault

LEAST_READINGS = 4
STALE_S = 2.0
"""A run ends when no reading came for so long, or for five readings where these are slower."""


class LengthSensor:
    """The length of a test by the instrument that the rig file names as ``length_source``.

    Args:
        rig: open instruments.

    Attributes:
        instrument: None where the camera measures the length.
    """

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self.instrument: Instrument | None = rig.length_reader
        self._seen = (0, 0)

    @property
    def rows(self) -> int:
        """Readings so far; 0 where there is no instrument."""
        return 0 if self.instrument is None else self.instrument.rows

    def needed(self, seconds: float) -> int:
        """How many readings a window of so many seconds holds at least."""
        if self.instrument is None:
            return 0
        return max(LEAST_READINGS, round(seconds * self.instrument.rate_hz))

    def look(self, blind: bool) -> None:
        """Called in every round; ``blind`` where the computer, not the device, is late.

        Raises:
            RunFault: the instrument is silent.
        """
        if self.instrument is None:
            return
        now_ns = self._rig.clock.now_ns()
        if blind or not self._seen[1] or self.rows != self._seen[0]:
            self._seen = self.rows, now_ns
            return
        stale_s = max(STALE_S, 5.0 / self.instrument.rate_hz)
        if now_ns - self._seen[1] > stale_s * NS_PER_S:
            detail = self.instrument.last_problem
            raise RunFault(
                self.instrument.name,
                f"no length reading for {stale_s:g} s" + (f" (last: {detail})" if detail else ""),
                "check its cable, its power and what it looks at",
            )

    def window(self, first: int, seconds: float) -> dict[str, list[int]]:
        """Wait until a window that began at reading ``first`` is full; its range of readings.

        Raises:
            RunFault: the readings did not come.
        """
        if self.instrument is None:
            return {}
        needed = first + self.needed(seconds)
        longest_s = 3.0 * self.needed(seconds) / self.instrument.rate_hz + 1.0
        if not self._rig.event_loop.until(lambda: self.rows >= needed, longest_s):
            detail = self.instrument.last_problem
            raise RunFault(
                self.instrument.name,
                f"sent too little during a window of {seconds:g} s"
                + (f" (last: {detail})" if detail else ""),
                "check rate, cable and baud rate",
            )
        return {"length_rows": [first, self.rows]}

    def recent_mm(self, readings: int) -> Any:
        """The newest readings in mm, oldest first."""
        assert self.instrument is not None
        return np.asarray(self.instrument.apply(self.instrument.recent(readings)[0]))
