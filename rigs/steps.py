"""What a protocol can ask of a bench, as plain values.

A protocol is a generator of these; it never touches a device. The runner carries each one
out, and whatever a step measured comes back as the value of its ``yield``.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass


@dataclass(frozen=True)
class State:
    """The test enters a new phase; shown live and kept in the record."""

    name: str


@dataclass(frozen=True)
class Vent:
    """Let the air out and confirm it by the pressure reading."""


@dataclass(frozen=True)
class SetLength:
    """Hold the muscle at a length."""

    length_mm: float


@dataclass(frozen=True)
class Tare:
    """Tare the balance; the muscle must be vented and slack."""


@dataclass(frozen=True)
class SetPressure:
    """Regulate the muscle's pressure."""

    pressure_kpa: float


@dataclass(frozen=True)
class Dwell:
    """Wait without measuring."""

    seconds: float


@dataclass(frozen=True)
class SettleCriterion:
    """When a point counts as settled.

    Over the last ``window_s``: the mean pressure lies within ``pressure_kpa`` of the
    set-point, its two halves differ by no more than ``drift_kpa``, every balance reading
    is marked stable and the halves of the force differ by no more than ``drift_n``.
    Not settled after ``timeout_s``: the point is measured all the same and marked.
    """

    window_s: float
    pressure_kpa: float
    drift_kpa: float
    drift_n: float
    timeout_s: float


@dataclass(frozen=True)
class Settle:
    """Wait for the criterion; the yield's value is (settled, seconds waited)."""

    criterion: SettleCriterion
    pressure_kpa: float


@dataclass(frozen=True)
class Zero:
    """Record a reading of the vented muscle."""

    trial: int
    when: str
    seconds: float


@dataclass(frozen=True)
class Measure:
    """Record one settled point over a window of ``seconds`` with ``frames`` pictures."""

    trial: int
    slot: str
    replicate: int
    order: int
    mounting: str
    direction: str
    set_pressure_kpa: float
    set_length_mm: float
    seconds: float
    frames: int
    settled: bool = True
    waited_s: float = 0.0


Step = State | Vent | SetLength | Tare | SetPressure | Dwell | Settle | Zero | Measure
Answer = tuple[bool, float] | None
Steps = Generator[Step, Answer, None]
