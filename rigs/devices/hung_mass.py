"""What hangs on the muscle, by the force sensor that the muscle hangs from."""

from __future__ import annotations

from typing import Protocol

READINGS = 10


class ForceReader(Protocol):
    """An instrument that reads force in N."""

    def next_mean(self, n: int) -> float:
        """Mean of the next ``n`` readings."""
        ...


class HungMass:
    """Mass by the change of force since nothing hung, in kg.

    Args:
        reader: the force sensor; muscle, clamps and hook hang on it always.
        gravity_m_s2: where the bench stands.
    """

    def __init__(self, reader: ForceReader, gravity_m_s2: float) -> None:
        self._reader = reader
        self._gravity = gravity_m_s2
        self._empty_n: float | None = None

    def look(self) -> None:
        """Read the sensor while nothing hangs yet; once."""
        if self._empty_n is None:
            self._empty_n = self._reader.next_mean(READINGS)

    def __call__(self) -> float:
        """What hangs now, in kg."""
        assert self._empty_n is not None
        return (self._reader.next_mean(READINGS) - self._empty_n) / self._gravity
