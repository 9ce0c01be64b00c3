"""Where the gap lies: shares of the stages, and designed comparisons of residuals.

Shares are exact Shapley values of the chain run end to end (`gap.validation.chain`,
`gap.validation.shapley`). The comparisons are of the recalibrated residual with measured signals
fed into each block.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
from scipy.stats import norm
from scipy.stats import t as student

from gap.data.trial import Trial
from gap.estimation.cross_validation import HeldOut, held_out
from gap.estimation.fit_problem import FitProblem, FitResult
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


def contrasts_of(problem: FitProblem, fit: FitResult | None = None) -> tuple[Contrast, ...]:
    """Designed comparisons of the recalibrated residual, each with its own z over slots.

    A contrast is the difference of two means within a trial (or between trials), averaged over
    the replicates of a slot; slots are the independent units. `alarm` controls the family-wise
    rate at 1 % over the whole table. With `fit` the residual is what that state leaves.
    """
    residual = (problem.base if fit is None else fit).residual
    made: list[tuple[str, float | None, bool]] = []
    for block in ("force", "load", "pressure"):
        here = problem.rows.block == BLOCKS.index(block)
        if here.sum() < 8:
            continue
        for name, first, second in _designs(problem, block):
            z = _within(problem, residual, here & first, here & second)
            made.append((f"{name} ({block})", z, False))
        made.append((f"hot-cold ({block})", _warmth(problem, residual, here), False))
        made.append((f"early-late trials ({block})", _order(problem, residual, here), True))
    found = [(name, z, drift) for name, z, drift in made if z is not None]
    least = float(norm.isf(VALIDATION.family_wise / 2.0 / max(len(found), 1)))
    found.sort(key=lambda item: -abs(item[1]))
    return tuple(Contrast(name, z, abs(z) > least, drift) for name, z, drift in found)


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


def _within(problem: FitProblem, residual: Array, first: Mask, second: Mask) -> float | None:
    """Z of the difference of two means, over slots."""
    values: list[float] = []
    for members in problem.data.slots.values():
        here: list[float] = []
        for trial in members:
            rows = problem.noise.trial_rows[trial]
            a, b = rows[first[rows]], rows[second[rows]]
            if len(a) and len(b):
                here.append(float(residual[a].mean() - residual[b].mean()))
        if here:
            values.append(float(np.mean(here)))
    return _z(np.array(values))


def _order(problem: FitProblem, residual: Array, here: Mask) -> float | None:
    """Z of the trend of trial means over the order of trials, slots' own means taken out."""
    x: list[float] = []
    y: list[float] = []
    for members in problem.data.slots.values():
        means = []
        for trial in members:
            rows = problem.noise.trial_rows[trial]
            rows = rows[here[rows]]
            if len(rows):
                order = problem.data.trials[trial].order
                if np.isfinite(order):
                    means.append((order, float(residual[rows].mean())))
        if len(means) > 1:
            table = np.array(means)
            table -= table.mean(axis=0)
            x += table[:, 0].tolist()
            y += table[:, 1].tolist()
    if len(x) < 6 or not np.any(x):
        return None
    a, b = np.array(x), np.array(y)
    slope = float(a @ b / (a @ a))
    rest = b - slope * a
    freedom = max(len(a) // 2 - 1, 1)
    error = float(np.sqrt(rest @ rest / freedom / (a @ a)))
    return _normal(slope / error, freedom) if error > 0.0 else None


_WARMER_K = 3.0


def _warmth(problem: FitProblem, residual: Array, here: Mask) -> float | None:
    """Z of hot against cold trials that are otherwise set alike, over such settings."""
    groups: dict[object, list[tuple[float, float]]] = {}
    for members in problem.data.slots.values():
        first = problem.data.trials[members[0]]
        alike = (first.protocol, str(first.held_length_mm), str(first.load_kg))
        for trial in members:
            rows = problem.noise.trial_rows[trial]
            rows = rows[here[rows]]
            warm = _temperature(problem.data.trials[trial])
            if len(rows) and np.isfinite(warm):
                own = (warm, float(residual[rows].mean()))
                groups.setdefault(alike, []).append(own)
    values = []
    for pairs in groups.values():
        table = np.array(pairs)
        middle = 0.5 * (table[:, 0].min() + table[:, 0].max())
        if np.ptp(table[:, 0]) > _WARMER_K:
            hot = table[:, 0] > middle
            values.append(float(table[hot, 1].mean() - table[~hot, 1].mean()))
    return _z(np.array(values))


def _temperature(trial: Trial) -> float:
    channel = trial.get("temperature_c")
    return float(np.mean(channel.value)) if len(channel) else trial.temperature_c


def _z(values: Array) -> float | None:
    if len(values) < 3:
        return None
    error = float(values.std(ddof=1) / np.sqrt(len(values)))
    return _normal(float(values.mean()) / error, len(values) - 1) if error > 0.0 else None


def _normal(t: float, freedom: int) -> float:
    """The z that is as unlikely as t with few degrees of freedom."""
    return float(np.sign(t) * norm.isf(max(student.sf(abs(t), freedom), 1e-300)))
