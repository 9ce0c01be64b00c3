"""What a protocol can do on a bench, as plain values.

A protocol is a generator of these; it never touches a device. The runner carries each one
out, and whatever a step measured comes back as the value of its ``yield``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


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
    """Tare the force sensor; the muscle must be vented and slack."""


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
    is marked stable and the halves of the force differ by no more than ``drift_n``; with
    ``drift_mm``, two pictures taken ``window_s`` apart give the same length to that much.
    What is None is not watched. Not settled after ``timeout_s``: the point is measured all
    the same and marked.
    """

    window_s: float
    pressure_kpa: float
    drift_kpa: float
    drift_n: float | None
    timeout_s: float
    drift_mm: float | None = None

    def as_dict(self) -> dict[str, float]:
        """The values as they go into the record, without what is not watched."""
        return {k: v for k, v in vars(self).items() if v is not None}


@dataclass(frozen=True)
class Settle:
    """Wait for the criterion at the set-point ``pressure_kpa``.

    The yield's value is (settled, seconds waited).
    """

    criterion: SettleCriterion
    pressure_kpa: float


@dataclass(frozen=True)
class Zero:
    """Record a reading of the vented muscle.

    Attributes:
        trial: number of the trial.
        when: "before" or "after" the trial.
        seconds: duration of the reading.
    """

    trial: int
    when: str
    seconds: float


@dataclass(frozen=True)
class Measure:
    """Record one settled point over a window of ``seconds`` with ``frames`` pictures.

    Attributes:
        trial, slot, replicate, order, mounting: those of the trial; ``order`` counts the points.
        direction: "up" or "down".
        set_pressure_kpa: set-point of the pressure.
        set_length_mm: length to which the stage was sent; None for a hung load.
        settled: whether the settling criterion was met.
        waited_s: how long it took.
        mass_kg: hung mass; None without one.
        cycle_max_kpa: pressure at which the cycle turns; None without a cycle.
        set_temperature_c: temperature that was set; None without one.
    """

    trial: int
    slot: str
    replicate: int
    order: int
    mounting: str
    direction: str
    set_pressure_kpa: float
    set_length_mm: float | None
    seconds: float
    frames: int
    settled: bool = True
    waited_s: float = 0.0
    mass_kg: float | None = None
    cycle_max_kpa: float | None = None
    set_temperature_c: float | None = None

    def fields(self) -> dict[str, Any]:
        """What the event of this point says, without the fields of other tests."""
        own = {k: v for k, v in vars(self).items() if k not in ("seconds", "frames")}
        return {k: v for k, v in own.items() if v is not None or k not in _OPTIONAL}


_OPTIONAL = ("set_length_mm", "mass_kg", "cycle_max_kpa", "set_temperature_c")


@dataclass(frozen=True)
class Trial:
    """A trial begins: one setting, one replicate; ``order`` counts the trials of a run.

    ``slot`` names the setting: trials with one slot are replicates of each other. What is
    held in the trial stands in ``held`` (``held_length_mm``, ``load_kg``, ``temperature_c``,
    ``held_pressure_kpa``). ``mounting`` names the mounting of the muscle, ``protocol`` the
    method of the trial.
    """

    trial: int
    slot: str
    replicate: int
    order: int
    mounting: str
    protocol: str
    held: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True)
class EndTrial:
    """The trial is whole."""

    trial: int
