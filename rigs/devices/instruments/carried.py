"""Readings that come over the link of another device: of a card, or of the valve controller."""

from __future__ import annotations

from collections.abc import Callable

from daq.calibration import Calibration
from daq.errors import DeviceTimeout
from rigs.devices.event_loop import EventLoop
from rigs.devices.instruments.readings import Readings


class CarriedReadings(Readings):
    """A channel without a port of its own.

    Args:
        quantity: what is measured, with unit.
        unit: unit of the readings as they come.
        calibration: turns readings into ``quantity``; None takes them as they are.
        event_loop: of the bench.
        rate_hz: readings a second.
        advice: what to check where none comes.
    """

    def __init__(
        self,
        quantity: str,
        unit: str,
        calibration: Calibration | None,
        *,
        event_loop: EventLoop,
        rate_hz: float,
        advice: str,
    ) -> None:
        super().__init__(quantity, unit, calibration)
        self._event_loop = event_loop
        self._advice = advice
        self.rate_hz = rate_hz
        self.identity: dict[str, str] = {}
        self.on_bytes: Callable[[int, bytes], None] | None = None

    @property
    def name(self) -> str:
        """Which channel of which device."""
        raise NotImplementedError

    @property
    def midway(self) -> bool:
        """Messages of the other device come whole."""
        return False

    def finish(self) -> None:
        """Nothing is left half read."""

    def next_mean(self, n: int) -> float:
        """Wait for ``n`` new readings and return their mean in ``quantity``.

        Raises:
            DeviceTimeout: they did not come.
        """
        self._await(n, 3.0 * n / self.rate_hz + 1.0)
        return self.mean(n)

    def _first(self, seconds: float) -> None:
        """Wait for the first reading.

        Raises:
            DeviceTimeout: none came.
        """
        if not self._event_loop.until(lambda: self.rows > 0, seconds):
            raise DeviceTimeout(
                self.name, f"no reading within {seconds:g} s"
                + (f" (last: {self.faults.last})" if self.faults.last else ""),
                self._advice,
            )  # fmt: skip

    def _await(self, n: int, seconds: float) -> None:
        start = self.rows
        if not self._event_loop.until(lambda: self.rows >= start + n, seconds):
            raise DeviceTimeout(
                self.name, f"{self.rows - start} of {n} readings within {seconds:g} s",
                self.faults.last or self._advice,
            )  # fmt: skip
