"""Errors of a fit on data that it was not fitted to.

Errors are root mean squares over time (or points) of one block, in its own unit. Whole slots are
left out in turn: constants and effects are fitted to the others, and the error is taken on the slot
left out. The floor is the scatter of the replicates of a slot.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.stats import t as student

from gap.estimation.fit_problem import FitProblem, FitResult
from gap.estimation.information import damped_step, gather, tolerance
from gap.estimation.noise import at_equal_inputs
from gap.model.features import BLOCKS, UNITS
from gap.model.grid import same_conditions
from gap.verdict import Gap
from plant.arrays import Array


@dataclass(frozen=True)
class HeldOut:
    """Sums over each held-out unit of one block: squared errors and weights, shape (units,).

    Attributes:
        fitted: the same (recalibrated, after) with nothing left out, where that is known.
    """

    before: Array
    recalibrated: Array
    after: Array
    floor: Array
    weight: Array
    fitted: tuple[Array, Array] | None = None

    def rms(self, which: str) -> float:
        """Root mean square error over all units."""
        total = float(self.weight.sum())
        return float(np.sqrt(max(float(getattr(self, which).sum()), 0.0) / max(total, 1e-12)))

    def errors(self, several: bool) -> tuple[float, float]:
        """Root mean square errors of the recalibrated plant and after.

        Those of the fit where there are not several units: a single one cannot be left out.
        """
        if several or self.fitted is None:
            return self.rms("recalibrated"), self.rms("after")
        total = max(float(self.weight.sum()), 1e-12)
        before, after = (float(squares.sum()) for squares in self.fitted)
        return float(np.sqrt(max(before, 0.0) / total)), float(np.sqrt(max(after, 0.0) / total))

    def with_floor_shown(self) -> HeldOut:
        """The same with no floor above the error that was reached, where that is less in all.

        Replicates that an effect makes differ, such as wear, show more than their scatter.
        """
        if float(self.after.sum()) >= float(self.floor.sum()):
            return self
        return replace(self, floor=np.minimum(self.floor, self.after))

    def closed(self, least: int = 3) -> tuple[float, float, float] | None:
        """Closed fraction with its 95 % interval by the jackknife over `least` units or more.

        Held-out errors give a little too little for the plant fitted to all units, and errors of
        that fit a little too much: the interval reaches to the upper end of both. A ratio above one
        shows that the floor was stated too high; the lower end is then reduced by as much. None
        where the gap beyond the floor is not certain.
        """
        use = self.weight > 0.0
        found = _ratio(
            (self.recalibrated - self.after)[use], (self.recalibrated - self.floor)[use], least
        )
        if found is None:
            return None
        ratio, low, high = found
        if self.fitted is not None:
            base, after = self.fitted
            inside = _ratio((base - after)[use], (base - self.floor)[use], least)
            high = max(high, inside[2]) if inside is not None else high
        return ratio, low - max(ratio - 1.0, 0.0), high


def _ratio(a: Array, b: Array, least: int) -> tuple[float, float, float] | None:
    """Ratio of two sums over units, with its 95 % interval by the jackknife."""
    n = len(a)
    if n < least or b.sum() <= 0.0:
        return None
    ratio = float(a.sum() / b.sum())
    left = (a.sum() - a) / np.where(np.abs(b.sum() - b) < 1e-12, np.nan, b.sum() - b)
    left = left[np.isfinite(left)]
    if len(left) < least:
        return None
    spread = float(np.sqrt((len(left) - 1) / len(left) * np.sum((left - left.mean()) ** 2)))
    reach = float(student.ppf(0.975, max(len(left) - 1, 1))) * spread
    return ratio, ratio - reach, ratio + reach


def held_out(
    problem: FitProblem, fit: FitResult, units: npt.NDArray[np.int64] | None = None
) -> dict[str, HeldOut]:
    """Squared errors of every block on held-out units (slots unless `units` says otherwise)."""
    of_trial = problem.units if units is None else units
    base = left_out(problem, problem.base, of_trial).squares
    after = left_out(problem, fit, of_trial).squares if fit.candidates else base
    floor = floor_squares(problem, of_trial)
    made: dict[str, HeldOut] = {}
    count = int(of_trial.max(initial=-1)) + 1
    for number, block in enumerate(BLOCKS):
        here = problem.rows.block == number
        if not here.any():
            continue
        unit = of_trial[problem.rows.trial[here]]
        span = problem.rows.compared_s[here]
        weight = np.asarray(np.bincount(unit, weights=span, minlength=count), dtype=np.float64)
        squares = span * problem.stated_residual[here] ** 2
        before = np.asarray(np.bincount(unit, weights=squares, minlength=count), dtype=np.float64)
        inside = tuple(
            np.asarray(
                np.bincount(unit, weights=span * fit.residual[here] ** 2, minlength=count),
                dtype=np.float64,
            )
            for fit in (problem.base, fit)
        )
        made[block] = HeldOut(
            before, base[block], after[block], floor[block], weight, (inside[0], inside[1])
        )
    return made


@dataclass(frozen=True)
class Folds:
    """Fits with one held-out unit left out at a time, linearised at one state.

    Attributes:
        change: change of [constants in sd, amounts] from that state, shape (units, columns).
        squares: squared errors on the unit left out, by block, shape (units,) each.
    """

    change: Array
    squares: dict[str, Array]


def left_out(problem: FitProblem, fit: FitResult, of_trial: npt.NDArray[np.int64]) -> Folds:
    """Fit constants and amounts near `fit` to all units but one, for each unit in turn.

    Amounts have the catalogue's range as a wide prior around no effect, and stay inside it: where
    the other units say nothing of an effect, it is not there.
    """
    n = len(problem.names)
    low, high = np.array([s.bounds for s in fit.candidates]).reshape(-1, 2).T
    loose = 4.0 / np.maximum(high - low, 1e-30) ** 2  # half the range is one sd
    columns = problem.columns_of(fit)
    evidence = gather(
        problem.noise, columns, fit.residual, np.zeros((len(problem.rows), 0)), problem.rows.block,
        problem.rows.compared_s, of_trial, np.zeros(columns.shape[1]),
    )  # fmt: skip
    width = columns.shape[1]
    total = evidence.total
    _, slope, stiffness = tolerance(fit.shift)
    errors = {block: np.zeros(len(evidence.gram)) for block in evidence.plain}
    change = np.zeros((len(evidence.gram), width))
    for unit in range(len(evidence.gram)):
        gram = total - evidence.gram[unit]
        matrix = gram[:width, :width].copy()
        matrix[range(n), range(n)] += stiffness
        right = gram[:width, width].copy()
        right[:n] -= slope
        matrix[range(n, width), range(n, width)] += loose
        right[n:] -= loose * fit.amounts
        beta = damped_step(matrix, right, 0.0)
        beta[n:] = np.clip(fit.amounts + beta[n:], low, high) - fit.amounts
        change[unit] = beta
        vector = np.r_[-beta, 1.0]
        for block, plain in evidence.plain.items():
            errors[block][unit] = float(vector @ plain[unit] @ vector)
    return Folds(change, errors)


def floor_squares(problem: FitProblem, of_trial: npt.NDArray[np.int64]) -> dict[str, Array]:
    """What replicates differ by, as squared errors of each unit and block.

    Bessel-corrected within slots; slots without replicates get the noise model's variance.
    """
    rows = problem.rows
    alike = same_conditions(problem.data)
    count = int(of_trial.max(initial=-1)) + 1
    made = {
        name: np.zeros(count) for number, name in enumerate(BLOCKS) if np.any(rows.block == number)
    }
    for members in problem.data.slots.values():
        for number, name in enumerate(BLOCKS):
            if name not in made:
                continue
            at = [
                problem.noise.trial_rows[t][rows.block[problem.noise.trial_rows[t]] == number]
                for t in members
            ]
            at = [a for a in at if len(a)]
            unit = of_trial[members[0]]
            if not at:
                continue
            weight = sum(float(rows.compared_s[a].sum()) for a in at)
            common = set(rows.bin[at[0]].tolist())
            for a in at[1:]:
                common &= set(rows.bin[a].tolist())
            if len(at) < 2 or len(common) < 3:
                made[name][unit] += sum(_expected(problem, t, number) for t in members)
                continue
            keep = [a[np.isin(rows.bin[a], list(common))] for a in at]
            # A floor is what replicates differ by at equal conditions.
            equal = np.all(
                [at_equal_inputs(rows, keep[0], other, alike) for other in keep[1:]], axis=0
            )
            if equal.sum() < 3:
                made[name][unit] += sum(_expected(problem, t, number) for t in members)
                continue
            keep = [a[equal] for a in keep]
            slow = np.zeros(len(rows)) if problem.noise.trend is None else problem.noise.trend
            table = np.stack([(problem.base.residual - slow)[a] for a in keep])
            span = np.mean([rows.compared_s[a] for a in keep], axis=0)
            variance = table.var(axis=0, ddof=1)
            made[name][unit] += float((span * variance).sum() / max(span.sum(), 1e-12)) * weight
    return made


def _expected(problem: FitProblem, trial: int, number: int) -> float:
    """Squared errors that the noise model expects of one trial and block."""
    rows = problem.noise.trial_rows[trial]
    here = problem.rows.block[rows] == number
    v = np.array([problem.noise.scales[kind] ** 2 for kind in problem.noise.kinds[trial]])
    variance = problem.noise.white[rows] + (problem.noise.columns[trial] ** 2) @ v
    return float((variance * problem.rows.compared_s[rows])[here].sum())


def gap_of(block: str, held: HeldOut, named: bool, source: str | None, scheme: str | None) -> Gap:
    """The verdict's gap of one block; without a scheme nothing is held out, as in a single slot."""
    closed = held.closed() if named and scheme else None
    recalibrated, after = held.errors(several=scheme is not None)
    return Gap(
        unit=UNITS[block],
        before=held.rms("before"),
        recalibrated=recalibrated,
        after=after if named else None,
        floor=held.rms("floor"),
        floor_source=source,
        closed=closed[0] if closed else None,
        closed_low=closed[1] if closed else None,
        closed_high=closed[2] if closed else None,
        held_out=scheme,
    )
