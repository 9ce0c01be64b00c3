"""Median and range of figures of merit over noise realizations."""

from __future__ import annotations

import statistics
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from studies.comparison.study import Row

STEP_KEYS = (
    "rise_s", "settling_s", "overshoot_percent", "steady_error_deg", "ripple_deg",
    "others_error_deg",
)  # fmt: skip
PATH_KEYS = ("rms_mm", "worst_mm")


@dataclass(frozen=True)
class Spread:
    """Median, lowest and highest value of a figure. None means not reached, above every number."""

    median: float | None
    low: float | None
    high: float | None

    def as_list(self) -> list[float | None]:
        """Median, lowest, highest, for JSON."""
        return [self.median, self.low, self.high]


def spread(values: Iterable[float | None]) -> Spread:
    """Median and range of one figure over the draws. Raises `ValueError` without draws."""
    ranked = sorted(float("inf") if value is None else value for value in values)
    if not ranked:
        raise ValueError("no draw to take a median of")

    def known(value: float) -> float | None:
        return None if value == float("inf") else value

    # For an even number the upper of the middle two, so that the median is the value of a draw.
    middle = statistics.median_high(ranked)
    return Spread(known(middle), known(ranked[0]), known(ranked[-1]))


@dataclass(frozen=True)
class Outcome:
    """One controller on one valve and plant over all draws.

    `figures` by the names of `StepFigures` and `PathFigures`, with the mean `switchings_per_s`;
    `held` is the number of accepted draws; `faults` are the causes latched in any draw.
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
        """Plain values for JSON: each figure as [median, lowest, highest]."""
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
    """One outcome per law, valve and plant, in the order of their first rows."""
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
