"""Where the gap lies: shares of the stages, and designed comparisons of residuals.

Shares are exact Shapley values of the chain run end to end (`gap.validation.chain`,
`gap.validation.shapley`). The comparisons are of the recalibrated residual with measured signals
fed into each block.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.stats import norm
from scipy.stats import t as student

from gap.data.trial import Trial
from gap.estimation.cross_validation import HeldOut, held_out
from gap.estimation.fit_problem import FitProblem, FitResult
from gap.estimation.null_distribution import simulated_residuals
from gap.model.clipping import CLIPPED_KPA
from gap.model.features import BLOCKS, UNITS
from gap.validation.chain import Chain
from gap.validation.config import VALIDATION
from gap.validation.shapley import waterfall
from gap.verdict import Contrast, Share
from plant.arrays import Array

Mask = npt.NDArray[np.bool_]

MEANING = (
    "Each stage is real (it gives the measured output for the measured input, and answers another "
    "input as its model does) or modelled (the recalibrated plant). A share is what modelling the "
    "stage adds to the squared end-to-end gap, averaged over all orders of doing so: recorded "
    "valve commands replayed, all subsets of stages run, noise taken out by products of "
    "replicates, pressure and pull added in units of their floors squared. Shares add up to one; "
    "a negative one makes up for another stage's error. Without a flow meter, what arises while a "
    "valve may be open counts to the valve, what arises while both are shut to the chamber, and "
    "what a named effect takes away to that effect's stage."
)
"""What a share means, in the words that the JSON carries."""


def stage_shares(
    problem: FitProblem, fit: FitResult, held: Mapping[str, HeldOut]
) -> tuple[Share, ...]:
    """Share of the end-to-end gap by stage, largest first; none where there is no gap for sure."""
    if not held:
        return ()
    return waterfall(Chain(problem, fit)).shares(known=bool(fit.candidates))


def stage_errors(problem: FitProblem, fit: FitResult) -> dict[str, list[dict[str, object]]]:
    """Free-running errors at the chain's ends and stage by stage with measured inputs, as plain
    tables: `end_to_end` and `stage_by_stage`, each with its floor.
    """
    flow = waterfall(Chain(problem, fit))
    return {
        "end_to_end": [
            {"end": name, "unit": UNITS[name], "rms": rms, "floor": floor}
            for name, (rms, floor) in flow.ends.items()
        ],
        "stage_by_stage": [
            {
                "block": block, "unit": UNITS[block], "untouched": part.rms("before"),
                "recalibrated": part.rms("recalibrated"), "after": part.rms("after"),
                "floor": part.rms("floor"),
            }
            for block, part in held_out(problem, fit).items()
        ],
    }  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Comparison:
    """A designed comparison: values that are linear in the residual, and the z of them.

    Attributes:
        weights: weights of the rows in each value, shape (values, rows).
        trend: what the values are regressed on; None where their mean is compared with zero.
        drift: it is a change over the order of trials.
    """

    name: str
    weights: Array
    trend: Array | None = None
    drift: bool = False

    def size(self, residual: Array) -> Array:
        """The mean, or the slope, of each column of residuals, shape (rows, columns)."""
        values = self.weights @ residual
        if self.trend is None:
            return np.asarray(values.mean(axis=0))
        return np.asarray(self.trend @ values / float(self.trend @ self.trend))

    def z(self, residual: Array) -> float:
        """Z of one residual, shape (rows,), from the spread of the values themselves."""
        values, found = self.weights @ residual, float(self.size(residual[:, None])[0])
        if self.trend is None:
            freedom = len(values) - 1
            error = float(values.std(ddof=1) / np.sqrt(len(values)))
        else:
            freedom = max(len(values) // 2 - 1, 1)
            rest = values - self.trend * found
            error = float(np.sqrt(rest @ rest / freedom / (self.trend @ self.trend)))
        return _normal(found / error, freedom) if error > 0.0 else 0.0


def contrasts_of(problem: FitProblem, fit: FitResult | None = None) -> tuple[Contrast, ...]:
    """Designed comparisons of the recalibrated residual, each with its own z over slots.

    A contrast is the difference of two means within a trial (or between trials), averaged over
    the replicates of a slot; slots are the independent units. With `fit` the residual is what that
    state leaves. `alarm` controls the family-wise rate. It needs two things: that slots agree (1 %
    over the whole table, whatever the noise is), and that the contrast is larger than the noise
    makes the largest of the table (5 %, by simulated data sets without a gap). A few slots may
    agree by chance on a difference far below the noise, and one gain acts on all slots. A drift
    over the trials needs the first alone, as replicates far apart in time take it for noise, and
    drifts have 1 % of their own: they are few, and nothing else shows what replicates hide.
    """
    residual = (problem.base if fit is None else fit).residual
    found = [(c, c.z(residual)) for c in _comparisons(problem)]
    found.sort(key=lambda item: -abs(item[1]))
    drifts = sum(c.drift for c, _ in found)
    least, least_drift = (
        float(norm.isf(VALIDATION.family_wise / 2.0 / max(count, 1)))
        for count in (len(found), drifts)
    )
    agree = [abs(z) > (least_drift if c.drift else least) for c, z in found]
    large = _larger_than_noise(problem, residual, [c for c, _ in found]) if any(agree) else agree
    return tuple(
        # Noise that was learnt from replicates holds a drift over the trials as well.
        Contrast(c.name, z, agrees and (exceeds or c.drift), c.drift)
        for (c, z), agrees, exceeds in zip(found, agree, large, strict=True)
    )


def _larger_than_noise(
    problem: FitProblem, residual: Array, table: Sequence[_Comparison]
) -> list[bool]:
    """Whether each contrast is larger than the noise makes the largest one of the table."""
    drawn = simulated_residuals(problem)
    sizes = np.array([c.size(drawn) for c in table])
    sd = np.maximum(sizes.std(axis=1), 1e-300)
    most = float(np.quantile((np.abs(sizes) / sd[:, None]).max(axis=0), 1.0 - VALIDATION.by_noise))
    own = np.array([float(c.size(residual[:, None])[0]) for c in table])
    return [bool(one) for one in np.abs(own) / sd > most]


def _comparisons(problem: FitProblem) -> list[_Comparison]:
    """All comparisons that a data set allows."""
    made: list[_Comparison | None] = []
    for block in ("force", "load", "pressure"):
        here = problem.rows.block == BLOCKS.index(block)
        if block == "pressure":
            here &= problem.rows.floor < 0.5 * CLIPPED_KPA  # what no gauge has shown is no contrast
        if here.sum() < 8:
            continue
        for name, first, second in _designs(problem, block):
            made.append(_within(problem, f"{name} ({block})", here & first, here & second))
        made.append(_warmth(problem, f"hot-cold ({block})", here))
        made.append(_order(problem, f"early-late trials ({block})", here))
    return [one for one in made if one is not None]


def remaining_drift(problem: FitProblem, fit: FitResult) -> Contrast | None:
    """The drift over the trials that an explanation leaves, if it leaves one."""
    return next(
        (
            c for c in contrasts_of(problem, fit)
            if c.alarm and c.drift and abs(c.z) > VALIDATION.drift_sd
        ),
        None,
    )  # fmt: skip


def _designs(problem: FitProblem, block: str) -> list[tuple[str, Mask, Mask]]:
    rows = problem.rows
    low, high = np.quantile(rows.pressure, [0.33, 0.67])
    short, long = np.quantile(rows.length, [0.33, 0.67])
    speed = np.abs(rows.rate)
    moving = speed > 0.5e-3
    quick = speed > np.median(speed[moving]) if moving.any() else moving
    start = np.zeros(len(rows))
    end = np.ones(len(rows))
    for trial_rows in problem.noise.trial_rows:
        if len(trial_rows):
            start[trial_rows] = rows.time_s[trial_rows].min()
            end[trial_rows] = rows.time_s[trial_rows].max()
    part = (rows.time_s - start) / np.maximum(end - start, 1e-9)
    rise = pressure_rise(problem)
    quiet = np.abs(rise) < 1.5e6
    designs = [
        (
            "fill-vent" if block == "pressure" else "up-down",
            (rise > 1e3) & (quiet | (block == "pressure")),
            (rise < -1e3) & (quiet | (block == "pressure")),
        ),
        ("low-high pressure", rows.pressure < low, rows.pressure > high),
        ("vented-pressurised", rows.pressure < 8e3, rows.pressure > 50e3),
        ("first-last third", part < 0.33, part > 0.67),
    ]
    if block != "pressure":
        designs += [
            ("lengthening-shortening", rows.rate > 0.5e-3, rows.rate < -0.5e-3),
            ("fast-slow", quick, ~quick),
            ("short-long", rows.length < short, rows.length > long),
        ]
    return designs


def pressure_rise(problem: FitProblem) -> Array:
    """Slope of the pressure at every row, Pa/s, from its neighbours in the trial."""
    rows = problem.rows
    made = np.zeros(len(rows))
    for at in problem.noise.trial_rows:
        for number in np.unique(rows.block[at]):
            own = at[rows.block[at] == number]
            own = own[np.argsort(rows.time_s[own], kind="stable")]
            if len(own) > 2 and np.all(np.diff(rows.time_s[own]) > 0.0):
                made[own] = np.gradient(rows.pressure[own], rows.time_s[own])
    return made


def _mean_of(problem: FitProblem, rows: npt.NDArray[np.int64]) -> Array:
    """Weights of the mean of some rows."""
    made = np.zeros(len(problem.rows))
    made[rows] = 1.0 / len(rows)
    return made


def _compared(name: str, values: Sequence[Array]) -> _Comparison | None:
    """The comparison of a mean with zero; None with too few values or none that differ."""
    return _Comparison(name, np.array(values)) if len(values) >= 3 else None


def _within(problem: FitProblem, name: str, first: Mask, second: Mask) -> _Comparison | None:
    """The difference of two means, over slots."""
    values: list[Array] = []
    for members in problem.data.slots.values():
        here: list[Array] = []
        for trial in members:
            rows = problem.noise.trial_rows[trial]
            a, b = rows[first[rows]], rows[second[rows]]
            if len(a) and len(b):
                here.append(_mean_of(problem, a) - _mean_of(problem, b))
        if here:
            values.append(np.mean(here, axis=0))
    return _compared(name, values)


def _order(problem: FitProblem, name: str, here: Mask) -> _Comparison | None:
    """The trend of trial means over the order of trials, slots' own means taken out."""
    x: list[float] = []
    y: list[Array] = []
    for members in problem.data.slots.values():
        orders: list[float] = []
        means: list[Array] = []
        for trial in members:
            rows = problem.noise.trial_rows[trial]
            rows = rows[here[rows]]
            order = problem.data.trials[trial].order
            if len(rows) and np.isfinite(order):
                orders.append(order)
                means.append(_mean_of(problem, rows))
        if len(means) > 1:
            x += (np.array(orders) - np.mean(orders)).tolist()
            y += [*(np.array(means) - np.mean(means, axis=0))]
    if len(x) < 6 or not np.any(x):
        return None
    return _Comparison(name, np.array(y), np.array(x), drift=True)


_WARMER_K = 3.0


def _warmth(problem: FitProblem, name: str, here: Mask) -> _Comparison | None:
    """Hot against cold trials that are otherwise set alike, over such settings."""
    groups: dict[object, list[tuple[float, Array]]] = {}
    for members in problem.data.slots.values():
        first = problem.data.trials[members[0]]
        alike = (first.protocol, str(first.held_length_mm), str(first.load_kg))
        for trial in members:
            rows = problem.noise.trial_rows[trial]
            rows = rows[here[rows]]
            warm = _temperature(problem.data.trials[trial])
            if len(rows) and np.isfinite(warm):
                groups.setdefault(alike, []).append((warm, _mean_of(problem, rows)))
    values = []
    for pairs in groups.values():
        degrees = np.array([own for own, _ in pairs])
        means = np.array([mean for _, mean in pairs])
        middle = 0.5 * (degrees.min() + degrees.max())
        if np.ptp(degrees) > _WARMER_K:
            hot = degrees > middle
            values.append(means[hot].mean(axis=0) - means[~hot].mean(axis=0))
    return _compared(name, values)


def _temperature(trial: Trial) -> float:
    channel = trial.get("temperature_c")
    return float(np.mean(channel.value)) if len(channel) else trial.temperature_c


def _normal(t: float, freedom: int) -> float:
    """The z that is as unlikely as t with few degrees of freedom."""
    return float(np.sign(t) * norm.isf(max(student.sf(abs(t), freedom), 1e-300)))
