"""What repeats in a residual: the period of a wave in time or length, the same in every slot.

Least-squares spectra (Lomb, Astrophys. Space Sci. 39 (1976) 447) with the phase of all slots in
common: a ripple of the supply starts with the trial, a camera's pixels stand still. A period is
offered where it is found again without any one slot: one that hangs on a single slot is a chance.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from gap.validation.config import VALIDATION
from plant.arrays import Array
from plant.compiled import entry_point, fingerprint, inlined
from plant.effects.arguments import Points
from plant.effects.empirical import SEEN

_LEAST_SHARE = 0.1
"""Share of the squares that a wave must take to be offered. A matter of definition."""
_LEAST_TURNS = 3.0
"""Periods in the range of an input: what is slower is a spline."""
_FINER = 4
"""Frequencies tried for each that the range of the input tells apart."""
_MOST = 100_000_000
"""Rows times frequencies that are tried, some seconds; of more rows the highest are not."""
_SLOWEST = {"time_s": 2, "length_mm": 3}
"""Degree of the polynomial that goes first: in time of each trial, in length of all together."""
_RIDGE = 1e-3
"""Share of the largest squares of a wave that is added to each, for those that rows hardly tell."""
_CLOSE = 0.25
"""Share of the distances of rows that are closer than the one that tells the shortest period."""


@dataclass(frozen=True)
class Wave:
    """What repeats: in an input, with a period in its unit, multiplied by a scale."""

    input: str
    scale: str
    period: float


@dataclass(frozen=True)
class WaveRows:
    """Rows of one block, shape (rows,) each: residual, weight, number of trial and of slot.

    Attributes:
        samples: number of readings in each row.
        apart_s: time between them; of a single one that which is usual in its trial.
    """

    residual: Array
    weight: Array
    trial: npt.NDArray[np.int64]
    slot: npt.NDArray[np.int64]
    samples: Array
    apart_s: Array

    @classmethod
    def of(
        cls, points: Points, residual: Array, weight: Array, trial: npt.NDArray[np.int64],
        slot: npt.NDArray[np.int64],
    ) -> WaveRows:  # fmt: skip
        """Rows of a block whose readings are `points`."""
        count = len(residual)
        samples = np.bincount(points.row, minlength=count).astype(np.float64)
        first, last = np.full(count, np.inf), np.full(count, -np.inf)
        np.minimum.at(first, points.row, points.time_s)
        np.maximum.at(last, points.row, points.time_s)
        apart = np.zeros(count)
        for k in np.unique(trial):
            own = points.time_s[points.first[k] : points.first[k + 1]]
            if len(own) > 1:
                apart[trial == k] = max(float(np.median(np.diff(own))), 0.0)
        some = samples > 1.0
        apart[some] = (last[some] - first[some]) / (samples[some] - 1.0)
        return cls(residual, weight, trial, slot, samples, apart)

    def taken(self, order: npt.NDArray[np.int64]) -> WaveRows:
        """The rows in another order."""
        return WaveRows(
            self.residual[order], self.weight[order], self.trial[order], self.slot[order],
            self.samples[order], self.apart_s[order],
        )  # fmt: skip


def waves_of(rows: WaveRows, at: Mapping[str, Array]) -> list[Wave]:
    """The waves of a residual, at most one for each input and scale.

    Args:
        at: inputs and scales at every row, of which those of time and length count, shape (rows,).
    """
    order = np.lexsort((rows.trial, rows.slot))
    ordered = rows.taken(order)
    made = []
    for name, scale in (
        ("time_s", ""), ("length_mm", ""), ("length_mm", "pull_per_mm"), ("length_mm", SEEN),
    ):  # fmt: skip
        if name in at and (not scale or scale in at):
            shape = at[scale][order] if scale else np.ones(len(order))
            apart = ordered.apart_s
            if name != "time_s":
                apart = apart * np.abs(at["velocity_mm_s"][order])
            periods = _periods(ordered, at[name][order], np.asarray(apart), shape, name)
            made += [Wave(name, scale, period) for period in periods]
    return made


def _periods(rows: WaveRows, x: Array, apart: Array, shape: Array, name: str) -> list[float]:
    """The periods that take most of the residual; none where none does for sure.

    Of time there are two: with what is slow in each trial, and without. Where few readings fall on
    a period a hum stands still in a trial or swings slowly, and that alone may tell one period from
    another that the readings of one trial show as well.

    Rows stand slot by slot, and trial by trial. `apart` is the distance of the readings in each.
    """
    by_trial = name == "time_s"
    groups = rows.trial if by_trial else np.zeros(len(x), dtype=np.int64)
    span = max((float(np.ptp(x[groups == k])) for k in np.unique(groups)), default=0.0)
    step = _shortest(rows) if by_trial else _step(x, rows.trial)
    if not span > 0.0 or step is None or len(np.unique(rows.slot)) < VALIDATION.least_slots:
        return []
    each = 1.0 / (_FINER * span)
    lowest, half = int(_LEAST_TURNS * _FINER), int(0.5 / step / each)
    # A wave with one period from reading to reading looks like a constant.
    highest = int(1.0 / step / each) - lowest if by_trial else half
    tried = _Tried(lowest, min(highest, _MOST // len(x)), each, half - lowest)
    if tried.count < _FINER:
        return []
    y, slow = _without_slow(rows, x, shape, groups, _SLOWEST[name])
    found = [_frequency(_Seen(rows, y, x, apart, shape, slow if by_trial else None), tried)]
    if by_trial:
        found.append(_frequency(_Seen(rows, rows.residual, x, apart, shape, None), tried))
    some = [one for one in found if one is not None]
    if len(some) > 1 and abs(some[0] - some[1]) < each:  # the whole residual tells the same best
        some = some[1:]
    return [float(f"{1.0 / one:.7g}") for one in some]


@dataclass(frozen=True)
class _Tried:
    """Frequencies that are tried: from `first` to `end` times `each`, without the last one.

    The first `shown` are slower than half of the readings a second.
    """

    first: int
    end: int
    each: float
    shown: int

    @property
    def count(self) -> int:
        return self.end - self.first


def _frequency(seen: _Seen, tried: _Tried) -> float | None:
    """The frequency that takes most; None where it takes little of all slots, or without one."""
    rows = seen.rows
    slots, first = np.unique(rows.slot, return_index=True)
    sums = seen.sums(first, tried.each * tried.first, tried.each, tried.count)
    gain = _gain(sums.sum(axis=0))
    best = int(np.argmax(gain))
    # Where all trials are read alike, a faster one looks like one that their readings show.
    shown = int(np.argmax(gain[: tried.shown]))
    squares = np.bincount(np.searchsorted(slots, rows.slot), weights=rows.weight * seen.y**2)
    noise = (squares.sum() - gain[best]) / len(rows.slot)
    if gain[best] - gain[shown] < _CLEARLY * noise:
        best = shown
    near = slice(max(best - _FINER, 0), best + _FINER + 1)
    without = (np.delete(sums, k, axis=0).sum(axis=0) for k in range(len(slots)))
    again = [gain[best], *(float(_gain(some[:, near]).max()) for some in without)]
    most = np.r_[squares.sum(), squares.sum() - squares]
    if (np.array(again) < _LEAST_SHARE * most).any():
        return None
    return seen.finest(tried.each * (tried.first + best), tried.each)


_CLEARLY = 6.0
"""How much more a wave that is faster than half of the readings a second must take than the best of
the slower ones, in variances of a row's noise: a ratio of likelihoods of about 20."""
_FINEST = 128
"""Frequencies tried on either side of the best."""


def _shortest(rows: WaveRows) -> float | None:
    """Time between readings in the trial that is read most often: it shows what no other does."""
    usual = (float(np.median(rows.apart_s[rows.trial == k])) for k in np.unique(rows.trial))
    return min((one for one in usual if one > 0.0), default=None)


def _step(x: Array, trial: npt.NDArray[np.int64]) -> float | None:
    """Distance of rows where they stand close: what is shorter they do not show."""
    apart = np.abs(np.diff(x))[np.diff(trial) == 0]
    apart = apart[apart > 1e-4 * max(float(np.ptp(x)), 1e-12)]
    return float(np.quantile(apart, _CLOSE)) if len(apart) else None


def _without_slow(
    rows: WaveRows, x: Array, shape: Array, groups: npt.NDArray[np.int64], degree: int
) -> tuple[Array, Array]:
    """Residual without a polynomial of the input, times the scale, in each group of rows.

    Returns:
        What is left, shape (rows,), and the polynomials, orthonormal in each group and with the
        weights, shape (rows, degree + 1).
    """
    left = rows.residual.copy()
    slow = np.zeros((len(x), degree + 1))
    for k in np.unique(groups):
        own = groups == k
        centre = x[own] - x[own].mean()
        centre = centre / max(float(np.abs(centre).max()), 1e-12)
        root = np.sqrt(rows.weight[own])
        columns = np.vander(centre, degree + 1) * shape[own, None]
        _, size, turn = np.linalg.svd(columns * root[:, None], full_matrices=False)
        kept = size > 1e-8 * max(float(size.max(initial=0.0)), 1e-150)
        even = columns @ (turn[kept].T / size[kept])
        left[own] -= even @ (even.T @ (left[own] * rows.weight[own]))
        slow[own, : even.shape[1]] = even
    return left, slow


@dataclass(frozen=True)
class _Seen:
    """What the rows see of waves: each is the mean of its readings.

    Attributes:
        y: residual without what is slow, shape (rows,).
        slow: polynomials that were taken out of the residual trial by trial, and so are of the
            waves; None where they were of all rows together.
    """

    rows: WaveRows
    y: Array
    x: Array
    apart: Array
    shape: Array
    slow: Array | None

    def sums(self, first: npt.NDArray[np.int64], lowest: float, each: float, count: int) -> Array:
        """Sums over the rows of each slot, from which the fit of a wave follows.

        Args:
            first: first row of each slot.

        Returns:
            Of [cosine, sine] times the residual, and of their products [cc, cs, ss], shape
            (slots, 5, frequencies).
        """
        made = np.zeros((len(first), 5, count))
        ends = np.r_[first, len(self.x)]
        new = np.flatnonzero(np.r_[True, np.diff(self.rows.trial) != 0, True])
        slow = np.zeros((len(self.x), 0)) if self.slow is None else np.ascontiguousarray(self.slow)
        rows = np.stack(
            [self.x, self.apart, self.rows.samples, self.shape, self.rows.weight, self.y]
        )
        whole = np.int64
        _sum_up(ends.astype(whole), new.astype(whole), rows, slow, lowest, each, made)
        return made

    def finest(self, middle: float, width: float) -> float:
        """The frequency that takes most within some width of another."""
        each = width / _FINEST
        start = middle - width
        around = _gain(self.sums(np.array([0]), start, each, 2 * _FINEST + 1)[0])
        best = min(max(int(np.argmax(around)), 1), 2 * _FINEST - 1)
        low, most, high = around[best - 1 : best + 2]
        bend = 2.0 * most - low - high
        beyond = 0.5 * (high - low) / bend if bend > 0.0 else 0.0
        return start + each * (best + min(max(beyond, -1.0), 1.0))


def _gain(sums: Array) -> Array:
    """Squares that each frequency takes, from sums of shape (5, frequencies)."""
    a, b, cc, cs, ss = sums
    even = _RIDGE * (cc + ss).max(initial=0.0) + 1e-150
    cc, ss = cc + even, ss + even
    return np.asarray((ss * a**2 - 2.0 * cs * a * b + cc * b**2) / (cc * ss - cs**2))


@inlined
def _mean_share(nc: Any, ns: Any, oc: Any, os: Any, samples: Any) -> Any:
    """What is left of a wave in the mean of its readings (Dirichlet's kernel).

    Args:
        nc: cosine and `ns` sine of half of its turn over all of them.
        oc: cosine and `os` sine of half of its turn from one to the next.
    """
    return ns / (samples * os) if abs(os) > 1e-6 else nc / oc


@inlined
def _take_out(part: Any, sums: Any) -> None:
    """Takes what is slow of the waves of a trial out of the sums of their products."""
    for k in range(part.shape[0]):
        for j in range(part.shape[2]):
            a, b = part[k, 0, j], part[k, 1, j]
            sums[2, j] -= a * a
            sums[3, j] -= a * b
            sums[4, j] -= b * b
            part[k, 0, j] = 0.0
            part[k, 1, j] = 0.0


def _build_sum_up(sources: int) -> Callable[..., None]:
    whole, matrix = "int64[::1]", "float64[:, ::1]"

    @entry_point(
        f"void({whole}, {whole}, {matrix}, {matrix}, float64, float64, float64[:, :, ::1])"
    )
    def sum_up(
        ends: Any, new: Any, rows: Any, slow: Any, lowest: Any, each: Any, sums: Any
    ) -> None:
        if sources < 0:
            return
        x, apart, samples, shape, weight, y = rows
        count, degrees = sums.shape[2], slow.shape[1]
        # What is slow of the waves of one trial.
        part = np.zeros((degrees, 2, count))
        slot, trial = 0, 0
        for r in range(len(x)):
            if r == ends[slot + 1]:
                slot += 1
            if r == new[trial + 1]:
                trial += 1
            # Three turning arrows: the wave at the row's middle, and what its mean follows from.
            turn = 2.0 * math.pi * x[r]
            width = math.pi * apart[r]
            c, s = math.cos(lowest * turn), math.sin(lowest * turn)
            dc, ds = math.cos(each * turn), math.sin(each * turn)
            nc, ns = math.cos(lowest * width * samples[r]), math.sin(lowest * width * samples[r])
            dnc, dns = math.cos(each * width * samples[r]), math.sin(each * width * samples[r])
            oc, os = math.cos(lowest * width), math.sin(lowest * width)
            doc, dos = math.cos(each * width), math.sin(each * width)
            own, even = weight[r] * y[r], weight[r]
            for j in range(count):
                seen = shape[r]
                if width > 0.0:
                    seen *= _mean_share(nc, ns, oc, os, samples[r])
                a, b = c * seen, s * seen
                sums[slot, 0, j] += own * a
                sums[slot, 1, j] += own * b
                sums[slot, 2, j] += even * a * a
                sums[slot, 3, j] += even * a * b
                sums[slot, 4, j] += even * b * b
                for k in range(degrees):
                    part[k, 0, j] += even * slow[r, k] * a
                    part[k, 1, j] += even * slow[r, k] * b
                c, s = c * dc - s * ds, s * dc + c * ds
                nc, ns = nc * dnc - ns * dns, ns * dnc + nc * dns
                oc, os = oc * doc - os * dos, os * doc + oc * dos
            if r + 1 == new[trial + 1]:
                _take_out(part, sums[slot])

    return sum_up


_sum_up = _build_sum_up(fingerprint())
