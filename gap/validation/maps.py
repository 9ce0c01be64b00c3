"""Residuals over pressure, length, temperature and time, before and after what was found.

One course each: time-weighted means in bins, with the error of the mean over trials (the trial is
the unit, samples of one are not independent), beside the floor of the replicates.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gap.estimation.cross_validation import floor_squares
from gap.estimation.fit_problem import FitProblem, FitResult
from gap.model.features import BLOCKS, UNITS
from plant.arrays import Array

Whole = npt.NDArray[np.int64]

MOST_BINS = 12
AXES = {"pressure": "kPa", "length": "mm", "temperature": "°C", "time": "s"}
"""What residuals are shown over, with units; time counts from the start of the trial."""


@dataclass(frozen=True)
class Course:
    """Mean residual of one block over one axis, one value a bin.

    Attributes:
        centre: mean of the axis in each bin, in `AXES` units.
        before, after: measured minus predicted, in `unit`, shape (bins,).
        error: standard error over trials of `before`; NaN in bins of a single trial.
        error_after: the same of `after`.
        trials: trials in each bin.
        floor: what replicates differ by, rms over the block.
    """

    block: str
    unit: str
    over: str
    centre: Array
    before: Array
    after: Array
    error: Array
    error_after: Array
    trials: Whole
    floor: float

    def as_dict(self) -> dict[str, object]:
        """Plain arrays for JSON."""
        return {
            "block": self.block, "unit": self.unit, "over": self.over,
            "over_unit": AXES[self.over], "centre": self.centre, "before": self.before,
            "before_error": self.error, "after": self.after, "after_error": self.error_after,
            "trials": self.trials, "floor": self.floor,
        }  # fmt: skip


def residual_maps(problem: FitProblem, fit: FitResult) -> list[Course]:
    """Courses of every block over every axis that varies in it."""
    made: list[Course] = []
    rows = problem.rows
    floors = floor_squares(problem, problem.units)
    for number, block in enumerate(BLOCKS):
        here = np.flatnonzero(rows.block == number)
        if not len(here):
            continue
        span = rows.compared_s[here]
        floor = float(np.sqrt(max(float(floors[block].sum()), 0.0) / max(span.sum(), 1e-12)))
        points = problem.grid.points[block]
        warm = problem.model._features(points, points.temperature)
        axes = {
            "pressure": rows.pressure[here] * 1e-3,
            "length": rows.length[here] * 1e3,
            "temperature": warm,
            "time": rows.time_s[here] if not problem.data.settled else np.full(len(here), np.nan),
        }
        for over, x in axes.items():
            course = _course(
                x, span, rows.trial[here], problem.base.residual[here], fit.residual[here]
            )
            if course is not None:
                made.append(Course(block, UNITS[block], over, *course, floor))
    return made


def _course(
    x: Array, span: Array, trial: Whole, before: Array, after: Array
) -> tuple[Array, Array, Array, Array, Array, Whole] | None:
    good = np.isfinite(x) & (span > 0.0)
    if good.sum() < 3 or float(np.ptp(x[good])) < 1e-6:
        return None
    x, span, before, after = (a[good] for a in (x, span, before, after))
    trial = trial[good]
    place = np.searchsorted(_edges(x), x, side="right") - 1
    table = []
    for k in np.unique(place):
        at = place == k
        means = []
        for t in np.unique(trial[at]):
            own = at & (trial == t)
            weight = span[own]
            means.append(
                (
                    weight.sum(), weight @ before[own] / weight.sum(),
                    weight @ after[own] / weight.sum(),
                )
            )  # fmt: skip
        own_weight, b, a = np.array(means).T
        table.append(
            (
                np.average(x[at], weights=span[at]), np.average(b, weights=own_weight),
                np.average(a, weights=own_weight), _error(b, own_weight), _error(a, own_weight),
                len(b),
            )
        )  # fmt: skip
    centre, mean, rest, error, error_after, count = np.array(table).T
    return centre, mean, rest, error, error_after, count.astype(np.int64)


def _error(values: Array, weight: Array) -> float:
    """Standard error of a weighted mean of independent values."""
    if len(values) < 2:
        return float("nan")
    share = weight / weight.sum()
    mean = share @ values
    n = len(values)
    return float(np.sqrt(share**2 @ (values - mean) ** 2 * n / (n - 1)))


def _edges(x: Array) -> Array:
    """Lower edges of bins: one for each setting where there are few, else evenly spaced."""
    settings = np.unique(np.round(x, 1))
    if len(settings) <= MOST_BINS:
        middle = 0.5 * (settings[:-1] + settings[1:])
        return np.asarray(np.r_[-np.inf, middle])
    low, high = np.quantile(x, [0.005, 0.995])
    inner = np.linspace(low, high, MOST_BINS + 1)[1:-1]
    return np.asarray(np.r_[-np.inf, inner])
