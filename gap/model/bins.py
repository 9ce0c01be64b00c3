"""How a trace becomes a modest number of features: means over bins that keep what matters.

Bins are fine just after a command edge, end at turning points, and grow where nothing happens, so
that a few hundred means a trial keep delays of a millisecond, loops and drifts of minutes alike.
Replicates of a slot share the bins of the first of them, so that their difference is noise.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from plant.arrays import Array

Whole = npt.NDArray[np.int64]

# Seconds after a command edge at which bins end, finest first.
_AFTER_FINE = np.r_[0, 3, 6, 8, 9, 10, 11, 12, 14, 16, 18, 20, 23, 26, 30, 36, 44, 55, 70] * 1e-3
_AFTER_FINE = np.r_[_AFTER_FINE, 0.09, 0.12, 0.16, 0.22, 0.3, 0.4, 0.55, 0.8, 1.2, 2.0, 4.0]
_AFTER = (_AFTER_FINE, _AFTER_FINE[::2], _AFTER_FINE[::4], _AFTER_FINE[[0, 12, 24]])


def bin_ends(
    first_s: float, last_s: float, spacing_s: float, marks: Array, turns: Array, most: int
) -> Array:
    """Ascending ends of bins over [first_s, last_s], at most about `most`, shape (bins + 1,)."""
    uniform = max(8, most // 3)
    for after in _AFTER:
        ends = np.linspace(first_s, last_s, uniform + 1)
        if len(marks):
            fine = (marks[:, None] + after[None, :]).ravel()
            following = np.r_[marks[1:], np.inf].repeat(len(after))
            ends = np.r_[ends, fine[fine < following]]
        ends = _thinned(np.r_[ends, turns], first_s, last_s, spacing_s)
        if len(ends) <= most:
            return np.asarray(ends)
    return np.asarray(ends[np.unique(np.linspace(0, len(ends) - 1, most).astype(np.int64))])


def _thinned(ends: Array, first_s: float, last_s: float, spacing_s: float) -> Array:
    """Drop ends closer to the one before than samples are apart."""
    ends = np.unique(ends[(ends > first_s) & (ends < last_s)])
    kept = [first_s]
    for end in ends:
        if end - kept[-1] >= 0.999 * spacing_s:
            kept.append(float(end))
    if last_s - kept[-1] < 0.999 * spacing_s and len(kept) > 1:
        kept.pop()
    return np.asarray(np.r_[kept, last_s + 1e-6])


def turning_points(time_s: Array, value: Array, least: float) -> Array:
    """Times at which a signal turns, excursions smaller than `least` ignored."""
    turns: list[float] = []
    if len(value) < 3:
        return np.empty(0)
    high = low = float(value[0])
    high_at = low_at = float(time_s[0])
    way = 0
    for t, v in zip(time_s.tolist(), value.tolist(), strict=True):
        if v > high:
            high, high_at = v, t
        if v < low:
            low, low_at = v, t
        if way >= 0 and v < high - least:
            if way > 0 or high_at > time_s[0]:
                turns.append(high_at)
            way, low, low_at = -1, v, t
            high, high_at = v, t
        elif way <= 0 and v > low + least:
            if way < 0 or low_at > time_s[0]:
                turns.append(low_at)
            way, high, high_at = 1, v, t
            low, low_at = v, t
    return np.array(turns)


_OUT_OF_STEP = 0.01
"""Share of a trial by which its turning points may differ from those of its first replicate."""
_BETTER = 0.7
"""Share of the difference of two replicates that must be left once their turns coincide."""


def means(bin_: Whole, value: Array, count: int) -> Array:
    """Mean of a signal in each bin, NaN in empty ones, shape (count,)."""
    size = np.bincount(bin_, minlength=count).astype(np.float64)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.bincount(bin_, weights=value, minlength=count) / size)


def in_step(
    time_s: Array, swing: Array, turns: Array, ends: Array, course: Array, first: Array
) -> Whole:
    """Bins of a replicate, on the clock of the first replicate where it was driven by hand.

    A trial driven by hand turns earlier or later than its replicates; bins that end at the turning
    points of one would mix both ways of another. Where the trial turns as often, time between
    turning points is stretched, if that brings its swing nearer to that of the first replicate: a
    turning point on a level is anywhere on it.

    Args:
        swing: signal that turns, shape of `time_s`.
        ends: ends of the bins of the first replicate.
        course: its start, turning points and end, ascending.
        first: its swing in each bin, shape (bins + 2,).
    """
    plain = np.searchsorted(ends, time_s, side="right")
    own = np.r_[time_s[0], turns, time_s[-1]]
    if len(turns) == 0 or len(own) != len(course) or np.any(np.diff(own) <= 0.0):
        return plain
    if np.abs(own - course).max() <= _OUT_OF_STEP * float(np.ptp(course)):
        return plain
    stretched = np.searchsorted(ends, np.interp(time_s, own, course), side="right")

    def off(bin_: Whole) -> float:
        return float(np.nanmean((means(bin_, swing, len(first)) - first) ** 2))

    return stretched if off(stretched) < _BETTER**2 * off(plain) else plain


def fold(time_s: Array, value: Array, turns: Array, parts: int) -> Whole:
    """Bins of a signal that swings faster than bins in time can follow: shape of `time_s`.

    Time part, direction and third of the swing together number the bin.
    """
    part = np.minimum(
        parts * (time_s - time_s[0]) / max(time_s[-1] - time_s[0], 1e-9), parts - 1
    ).astype(np.int64)
    half = np.searchsorted(turns, time_s)
    low, high = np.quantile(value, [0.02, 0.98])
    third = np.clip(4 * (value - low) / max(high - low, 1e-12), 0, 3).astype(np.int64)
    return np.asarray((part * 2 + half % 2) * 4 + third)


def matched(condition: Array, known: Array, alike: Array) -> tuple[Whole, Array]:
    """Bin of each settled point of a replicate, by its condition.

    A point takes the bin of its own row where that has the same condition, else the nearest bin
    with the same condition that no other point has, else a new one.

    Args:
        condition: one row a point: what was set, shape (points, n).
        known: condition of each bin so far, shape (bins, n).
        alike: largest difference of equal conditions, shape (n,).

    Returns:
        Bins of the points, and the conditions of all bins.
    """
    scale = np.maximum(alike, 1e-12)
    found = np.full(len(condition), -1, dtype=np.int64)
    free = np.ones(len(known), dtype=bool)
    for row, one in enumerate(condition[: len(known)]):
        if np.all(np.abs(one - known[row]) <= scale):
            found[row], free[row] = row, False
    for row in np.flatnonzero(found < 0).tolist():
        apart = np.abs(condition[row] - known[: len(free)]) / scale
        near = np.flatnonzero(free & np.all(apart <= 1.0, axis=1))
        if len(near):
            at = int(near[np.argmin(apart[near].sum(axis=1))])
            found[row], free[at] = at, False
        else:
            found[row] = len(known)
            known = np.vstack([known, condition[row]])
            free = np.r_[free, False]
    return found, known
