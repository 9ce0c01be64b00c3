"""What repeats in a residual: the period of a wave in time or length, the same in every slot.

Least-squares spectra (Lomb, Astrophys. Space Sci. 39 (1976) 447) with the phase of all slots in
common: a ripple of the supply starts with the trial, a camera's pixels stand still. A period is
offered where it is found again without any one slot: one that hangs on a single slot is a chance.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gap.validation.config import VALIDATION
from plant.arrays import Array
from plant.effects.empirical import SEEN

_LEAST_SHARE = 0.1
"""Share of the squares that a wave must take to be offered. A matter of definition."""
_LEAST_TURNS = 3.0
"""Periods in the range of an input: what is slower is a spline."""
_FINER = 4
"""Frequencies tried for each that the range of the input tells apart."""
_MOST = 8_000_000
"""Rows times frequencies that are tried, a matter of seconds; of more rows the highest are not."""
_AT_ONCE = 500_000
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
    """Rows of one block, shape (rows,) each: residual, weight, number of trial and of slot."""

    residual: Array
    weight: Array
    trial: npt.NDArray[np.int64]
    slot: npt.NDArray[np.int64]


def waves_of(rows: WaveRows, at: Mapping[str, Array], wide: Mapping[str, Array]) -> list[Wave]:
    """The waves of a residual, at most one for each input and scale.

    Args:
        at: inputs and scales at every row, of which those of time and length count, shape (rows,).
        wide: range of time and length in every row, over which a wave goes as a mean.
    """
    order = np.argsort(rows.slot, kind="stable")
    ordered = WaveRows(
        rows.residual[order], rows.weight[order], rows.trial[order], rows.slot[order]
    )
    made = []
    for name, scale in (
        ("time_s", ""), ("length_mm", ""), ("length_mm", "pull_per_mm"), ("length_mm", SEEN),
    ):  # fmt: skip
        if name in at and (not scale or scale in at):
            shape = at[scale][order] if scale else np.ones(len(order))
            period = _period(ordered, at[name][order], wide[name][order], shape, name)
            if period is not None:
                made.append(Wave(name, scale, period))
    return made


def _period(rows: WaveRows, x: Array, wide: Array, shape: Array, name: str) -> float | None:
    """The period that takes most of the residual; None where none does for sure.

    Rows stand slot by slot.
    """
    by_trial = name == "time_s"
    groups = rows.trial if by_trial else np.zeros(len(x), dtype=np.int64)
    span = max((float(np.ptp(x[groups == k])) for k in np.unique(groups)), default=0.0)
    step = _step(x, rows.trial, by_trial)
    slots, first = np.unique(rows.slot, return_index=True)
    if not span > 0.0 or step is None or len(slots) < VALIDATION.least_slots:
        return None
    apart = 1.0 / (_FINER * span)
    count = min(int(0.5 / step / apart), _MOST // len(x))
    tried = np.arange(int(_LEAST_TURNS * _FINER), count)
    frequency: Array = np.asarray(apart * tried, dtype=np.float64)
    if len(frequency) < _FINER:
        return None
    y = _without_slow(rows, x, shape, groups, _SLOWEST[name])
    spectra = _Spectra.of(rows.weight, y, shape, x, wide, first, frequency)
    gain = spectra.gain(spectra.sums.sum(axis=0))
    best = int(np.argmax(gain))
    if gain[best] < _LEAST_SHARE * float(rows.weight @ y**2):
        return None
    for k in range(len(slots)):
        again = int(np.argmax(spectra.gain(np.delete(spectra.sums, k, axis=0).sum(axis=0))))
        if abs(again - best) > _FINER:
            return None
    finer: Array = frequency[best] + apart * np.linspace(-1.0, 1.0, 17)
    around = _Spectra.of(rows.weight, y, shape, x, wide, np.array([0]), finer)
    found = finer[int(np.argmax(around.gain(around.sums[0])))]
    return float(f"{1.0 / found:.6g}")


def _step(x: Array, trial: npt.NDArray[np.int64], by_trial: bool) -> float | None:
    """Distance of rows where they stand close: what is faster they do not show."""
    if by_trial:
        apart = np.concatenate([np.diff(np.sort(x[trial == k])) for k in np.unique(trial)])
    else:
        apart = np.abs(np.diff(x))[np.diff(trial) == 0]
    apart = apart[apart > 1e-4 * max(float(np.ptp(x)), 1e-12)]
    return float(np.quantile(apart, _CLOSE)) if len(apart) else None


def _without_slow(
    rows: WaveRows, x: Array, shape: Array, groups: npt.NDArray[np.int64], degree: int
) -> Array:
    """Residual without a polynomial of the input, times the scale, in each group of rows."""
    left = rows.residual.copy()
    for k in np.unique(groups):
        own = groups == k
        centre = x[own] - x[own].mean()
        centre = centre / max(float(np.abs(centre).max()), 1e-12)
        columns = np.vander(centre, degree + 1) * shape[own, None]
        root = np.sqrt(rows.weight[own])
        found = np.linalg.lstsq(columns * root[:, None], left[own] * root, rcond=1e-8)[0]
        left[own] -= columns @ found
    return left


@dataclass(frozen=True)
class _Spectra:
    """Sums over the rows of each slot, from which the fit of a wave follows.

    Attributes:
        sums: of [cosine, sine] times the residual, and of their products [cc, cs, ss], shape
            (slots, 5, frequencies).
    """

    sums: Array

    @classmethod
    def of(
        cls, weight: Array, y: Array, shape: Array, x: Array, wide: Array,
        first: npt.NDArray[np.int64], frequency: Array,
    ) -> _Spectra:  # fmt: skip
        """Sums of rows that stand slot by slot; `first` is the first row of each."""
        made = np.empty((len(first), 5, len(frequency)))
        each = max(_AT_ONCE // len(x), 1)
        for start in range(0, len(frequency), each):
            f = frequency[start : start + each]
            turn = 2.0 * np.pi * np.outer(x, f)
            seen = np.sinc(np.outer(wide, f)) * shape[:, None]
            c, s = np.cos(turn) * seen, np.sin(turn) * seen
            wc, ws = c * weight[:, None], s * weight[:, None]
            parts = (wc * y[:, None], ws * y[:, None], wc * c, wc * s, ws * s)
            for k, part in enumerate(parts):
                made[:, k, start : start + each] = np.add.reduceat(part, first, axis=0)
        return cls(made)

    def gain(self, sums: Array) -> Array:
        """Squares that each frequency takes, from sums of shape (5, frequencies)."""
        a, b, cc, cs, ss = sums
        even = _RIDGE * (cc + ss).max(initial=0.0) + 1e-150
        cc, ss = cc + even, ss + even
        return np.asarray((ss * a**2 - 2.0 * cs * a * b + cc * b**2) / (cc * ss - cs**2))
