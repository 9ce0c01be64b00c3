"""An instrument whose reading is the length of a test, in place of the camera."""

from __future__ import annotations

from typing import Any

import numpy as np

from daq.clock import NS_PER_S
from rigs.bench.rig import Rig
from rigs.execution.source_instrument import SourceInstrument

STALE_S = 2.0
"""A run ends when no reading came for so long, or for five readings where these are slower."""


class LengthSensor(SourceInstrument):
    """The length of a test by the instrument that the rig file names as ``length_source``.

    Args:
        rig: open instruments.

    Attributes:
        instrument: None where the camera measures the length.
    """

    def __init__(self, rig: Rig) -> None:
        super().__init__(rig, rig.length_reader)
        self._seen = (0, 0)

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
            raise self.silent("length", stale_s, "check its cable, its power and what it looks at")

    def length_rows(self, first: int, seconds: float) -> dict[str, list[int]]:
        """The range of readings in a window, for the record; nothing where there are none."""
        return {} if self.instrument is None else {"length_rows": self.window(first, seconds)}

    def recent_mm(self, readings: int) -> Any:
        """The newest readings in mm, oldest first."""
        assert self.instrument is not None
        return np.asarray(self.instrument.apply(self.instrument.recent(readings)[0]))
