"""Where the gap lies: shares of the stages, and designed comparisons of residuals.

Each block of the recalibrated residual belongs to a stage (pressure to the chamber or, with what
was named, the valve; force to the muscle; a hung load to the load; camera against label to the
sensors). A block's part of the gap is its excess over the floor, in units of the floor, so that
blocks of different units can be added. What a named effect closes counts for the effect's stage.
Intervals are a jackknife over slots.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
from scipy.stats import norm
from scipy.stats import t as student

from gap.inquiry import Inquiry, State
from gap.rows import BLOCKS
from gap.shrink import Held
from gap.verdict import Contrast, Share
from plant.catalogue import CATALOGUE

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

_STAGE = {"pressure": "chamber", "force": "muscle", "load": "load", "camera": "sensor"}
_FAMILY_WISE = 0.01


def stage_shares(q: Inquiry, state: State, held: Mapping[str, Held]) -> tuple[Share, ...]:
    """Share of the gap by stage, largest first; none where no block stands above its floor."""
    parts = _parts(q, state, held, np.ones(_units(held), dtype=bool))
    whole = sum(parts.values())
    if whole <= 0.0:
        return ()
    used = np.flatnonzero(sum(h.weight for h in held.values()) > 0.0)
    left: list[dict[str, float]] = []
    for unit in used:
        keep = np.ones(_units(held), dtype=bool)
        keep[unit] = False
        part = _parts(q, state, held, keep)
        total = sum(part.values())
        if total > 0.0:
            left.append({stage: value / total for stage, value in part.items()})
    made = []
    for stage, value in parts.items():
        share = value / whole
        spread = 0.0
        if len(left) > 2:
            values = np.array([one.get(stage, 0.0) for one in left])
            n = len(values)
            spread = float(np.sqrt((n - 1) / n * np.sum((values - values.mean()) ** 2)))
        if share > 0.005:
            low, high = max(share - 1.96 * spread, 0.0), min(share + 1.96 * spread, 1.0)
            made.append(Share(stage, share, low, high))
    return tuple(sorted(made, key=lambda s: -s.share))


def _units(held: Mapping[str, Held]) -> int:
    return len(next(iter(held.values())).weight)


def _parts(q: Inquiry, state: State, held: Mapping[str, Held], keep: Mask) -> dict[str, float]:
    """Excess over the floor of each stage, in floors squared, over the units kept."""
    made: dict[str, float] = {}
    named = [CATALOGUE[name].stage for name in state.ids if name in CATALOGUE]
    for block, part in held.items():
        floor = max(float(part.floor[keep].sum()), 1e-12)
        gap = (float(part.recalibrated[keep].sum()) - floor) / floor
        if gap <= 0.0:
            continue
        closed = (float(part.recalibrated[keep].sum()) - float(part.after[keep].sum())) / floor
        closed = min(max(closed, 0.0), gap) if named else 0.0
        touched = [
            stage
            for stage, suspect in zip(named, state.suspects, strict=False)
            if block in suspect.blocks
        ]
        stage = touched[0] if touched and touched[0] != "any" else _STAGE[block]
        made[stage] = made.get(stage, 0.0) + closed
        made[_STAGE[block]] = made.get(_STAGE[block], 0.0) + gap - closed
    return made


def contrasts_of(q: Inquiry) -> tuple[Contrast, ...]:
    """Designed comparisons of the recalibrated residual, each with its own z over slots.

    A contrast is the difference of two means within a trial (or between trials), averaged over
    the replicates of a slot; slots are the independent units. `alarm` controls the family-wise
    rate at 1 % over the whole table.
    """
    made: list[tuple[str, float]] = []
    for block in ("force", "load", "pressure"):
        here = q.rows.block == BLOCKS.index(block)
        if here.sum() < 8:
            continue
        for name, first, second in _designs(q, block):
            z = _within(q, here & first, here & second)
            if z is not None:
                made.append((f"{name} ({block})", z))
        z = _order(q, here)
        if z is not None:
            made.append((f"early-late trials ({block})", z))
    least = float(norm.isf(_FAMILY_WISE / 2.0 / max(len(made), 1)))
    made.sort(key=lambda item: -abs(item[1]))
    return tuple(Contrast(name, z, abs(z) > least) for name, z in made)


def _designs(q: Inquiry, block: str) -> list[tuple[str, Mask, Mask]]:
    rows = q.rows
    low, high = np.quantile(rows.pressure, [0.33, 0.67])
    short, long = np.quantile(rows.length, [0.33, 0.67])
    speed = np.abs(rows.rate)
    moving = speed > 0.5e-3
    quick = speed > np.median(speed[moving]) if moving.any() else moving
    start = np.zeros(len(rows))
    end = np.ones(len(rows))
    for trial_rows in q.noise.trial_rows:
        if len(trial_rows):
            start[trial_rows] = rows.time_s[trial_rows].min()
            end[trial_rows] = rows.time_s[trial_rows].max()
    part = (rows.time_s - start) / np.maximum(end - start, 1e-9)
    designs = [
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


def _within(q: Inquiry, first: Mask, second: Mask) -> float | None:
    """Z of the difference of two means, over slots."""
    values: list[float] = []
    for members in q.data.slots.values():
        here: list[float] = []
        for trial in members:
            rows = q.noise.trial_rows[trial]
            a, b = rows[first[rows]], rows[second[rows]]
            if len(a) and len(b):
                here.append(float(q.base.residual[a].mean() - q.base.residual[b].mean()))
        if here:
            values.append(float(np.mean(here)))
    return _z(np.array(values))


def _order(q: Inquiry, here: Mask) -> float | None:
    """Z of the trend of trial means over the order of trials, slots' own means taken out."""
    x: list[float] = []
    y: list[float] = []
    for members in q.data.slots.values():
        means = []
        for trial in members:
            rows = q.noise.trial_rows[trial]
            rows = rows[here[rows]]
            if len(rows):
                means.append((q.data.trials[trial].order, float(q.base.residual[rows].mean())))
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


def _z(values: Array) -> float | None:
    if len(values) < 3:
        return None
    error = float(values.std(ddof=1) / np.sqrt(len(values)))
    return _normal(float(values.mean()) / error, len(values) - 1) if error > 0.0 else None


def _normal(t: float, freedom: int) -> float:
    """The z that is as unlikely as t with few degrees of freedom."""
    return float(np.sign(t) * norm.isf(max(student.sf(abs(t), freedom), 1e-300)))
