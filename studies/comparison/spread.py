"""Figures over draws of the noise: median and range, the rows of one case put together."""

from __future__ import annotations

import statistics
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from studies.comparison.study import Row

STEP_KEYS = (
    "rise_s",
    "settling_s",
    "overshoot_percent",
    "steady_error_deg",
    "ripple_deg",
    "others_error_deg",
)
PATH_KEYS = ("rms_mm", "worst_mm")


@dataclass(frozen=True)
class Spread:
    """Median, least and largest of a figure. None is "never", which is above every number."""

    median: float | None
    low: float | None
    high: float | None

    def as_list(self) -> list[float | None]:
        """Median, least, largest, for JSON."""
        return [self.median, self.low, self.high]


def spread(values: Iterable[float | None]) -> Spread:
    """Of one figure over the draws. Raises `ValueError` for none."""
    ranked = sorted(float("inf") if value is None else value for value in values)
    if not ranked:
        raise ValueError("no draw to take a median of")

    def known(value: float) -> float | None:
        return None if value == float("inf") else value

    # Of an even number the upper one of the middle two: a median that some draw had.
    middle = statistics.median_high(ranked)
    return Spread(known(middle), known(ranked[0]), known(ranked[-1]))


@dataclass(frozen=True)
class Outcome:
    """One controller on one valve and plant over all its draws.

    `figures` by the names of `StepFigures` and `PathFigures`, and `switchings_per_s` of both;
    `held` in how many of the `draws` it was accepted; `faults` whatever was latched in any.
    """

    law: str
    valve: str
    plant: str
    draws: int
    held: int
    figures: dict[str, Spread]
    learned_g: Spread | None
    faults: tuple[str, ...]

    def as_dict(self) -> dict[str, object]:
        """For JSON: every figure as [median, least, largest]."""
        return {
            "law": self.law,
            "valve": self.valve,
            "case": self.plant,
            "draws": self.draws,
            "accepted": self.held,
            **{key: value.as_list() for key, value in self.figures.items()},
            "learned_g": None if self.learned_g is None else self.learned_g.as_list(),
            "faults": list(self.faults),
        }


def over_draws(rows: Sequence[Row]) -> list[Outcome]:
    """Rows of the same law, valve and plant as one, in the order of their first."""
    groups: dict[tuple[str, str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row.valve, row.law, row.case), []).append(row)
    return [_outcome(group) for group in groups.values()]


def _outcome(rows: Sequence[Row]) -> Outcome:
    figures = {key: spread(getattr(row.step, key) for row in rows) for key in STEP_KEYS}
    figures |= {key: spread(getattr(row.path, key) for row in rows) for key in PATH_KEYS}
    figures["switchings_per_s"] = spread(
        (row.step.switchings_per_s + row.path.switchings_per_s) / 2.0 for row in rows
    )
    learned = [row.learned_g for row in rows if row.learned_g is not None]
    faults = {
        fault.split(": ")[1] for row in rows for fault in (*row.step.faults, *row.path.faults)
    }
    first = rows[0]
    return Outcome(
        first.law,
        first.valve,
        first.case,
        len(rows),
        sum(row.accepted for row in rows),
        figures,
        spread(learned) if learned else None,
        tuple(sorted(faults)),
    )
