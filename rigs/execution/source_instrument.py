"""An instrument whose reading is a quantity of a test: how many readings a window holds."""

from __future__ import annotations

from rigs.bench.rig import Rig
from rigs.devices.interfaces import Instrument
from rigs.steps.context import RunFault

LEAST_READINGS = 4


class SourceInstrument:
    """The source of a quantity, or none where another device measures it.

    Args:
        rig: open instruments.
        instrument: None where there is none.
    """

    def __init__(self, rig: Rig, instrument: Instrument | None) -> None:
        self._rig = rig
        self.instrument = instrument

    @property
    def rows(self) -> int:
        """Readings so far; 0 where there is no instrument."""
        return 0 if self.instrument is None else self.instrument.rows

    def needed(self, seconds: float) -> int:
        """How many readings a window of so many seconds holds at least."""
        if self.instrument is None:
            return 0
        return max(LEAST_READINGS, round(seconds * self.instrument.rate_hz))

    def window(self, first: int, seconds: float) -> list[int]:
        """Wait until a window that began at reading ``first`` is full; its range of readings.

        Raises:
            RunFault: the readings did not come.
        """
        assert self.instrument is not None
        needed = first + self.needed(seconds)
        longest_s = 3.0 * self.needed(seconds) / self.instrument.rate_hz + 1.0
        if not self._rig.event_loop.until(lambda: self.rows >= needed, longest_s):
            raise RunFault(
                self.instrument.name,
                f"sent too little during a window of {seconds:g} s{self._last()}",
                "check rate, cable and baud rate",
            )
        return [first, self.rows]

    def silent(self, what: str, seconds: float, remedy: str) -> RunFault:
        """The fault of an instrument that sent no ``what`` for so long."""
        assert self.instrument is not None
        return RunFault(
            self.instrument.name, f"no {what} reading for {seconds:g} s{self._last()}", remedy
        )

    def _last(self) -> str:
        detail = self.instrument.last_problem if self.instrument is not None else ""
        return f" (last: {detail})" if detail else ""
