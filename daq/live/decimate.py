"""Reduces 1 kHz curves to what a screen can show; keeps the minimum and maximum of each bin."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from daq.live.layout import Reduce

Floats = npt.NDArray[np.float64]


def decimate(
    time_s: Floats, values: Floats, bin_s: float, reduce: Reduce = "minmax"
) -> tuple[Floats, Floats]:
    """Reduce a curve to at most two points per bin ("minmax") or one point ("mean").

    Args:
        time_s: (n,) s, not decreasing.
        values: (n,); non-finite samples are dropped.
        bin_s: bin width, s. Bins start at multiples of it, so the result does not depend on how
            the samples were batched, as long as no bin is split.
        reduce: "minmax" keeps the smallest and largest sample of each bin at their own times;
            "mean" gives the mean value at the mean time.

    Returns:
        time_s and values of the reduced curve, in order of time.
    """
    good = np.isfinite(values) & np.isfinite(time_s)
    if not good.all():
        time_s, values = time_s[good], values[good]
    if len(time_s) == 0:
        return time_s, values
    bins = np.floor(time_s / bin_s + 1e-9).astype(np.int64)
    first = np.flatnonzero(np.concatenate(([True], bins[1:] != bins[:-1])))
    if len(first) == len(bins):  # already one sample per bin
        return time_s, values
    if reduce == "mean":
        count = np.diff(np.append(first, len(bins)))
        return np.add.reduceat(time_s, first) / count, np.add.reduceat(values, first) / count
    order = np.lexsort((values, bins))  # within a bin: lowest first, highest last
    last = np.append(first[1:], len(bins)) - 1
    keep = np.unique(np.concatenate((order[first], order[last])))
    return time_s[keep], values[keep]


def decimate_steps(time_s: Floats, values: Floats, bin_s: float) -> tuple[Floats, Floats]:
    """The same for a step curve, whose NaN stay: the curve has a gap from there on."""
    none = np.isnan(values)
    kept_s, kept = decimate(time_s, values, bin_s)
    times = np.concatenate((kept_s, time_s[none]))
    order = np.argsort(times, kind="stable")
    return times[order], np.concatenate((kept, values[none]))[order]


class Thinner:
    """Decimates a curve that arrives in batches; keeps the incomplete bin for the next batch."""

    def __init__(self, bin_s: float, reduce: Reduce = "minmax") -> None:
        self.bin_s = bin_s
        self.reduce = reduce
        self._time_s = np.empty(0)
        self._values = np.empty(0)

    def feed(self, time_s: Floats, values: Floats) -> tuple[Floats, Floats]:
        """Add samples; returns the decimated complete bins."""
        if len(self._time_s):
            time_s = np.concatenate((self._time_s, time_s))
            values = np.concatenate((self._values, values))
        if len(time_s) == 0:
            return time_s, values
        if np.any(time_s[1:] < time_s[:-1]):
            order = np.argsort(time_s, kind="stable")
            time_s, values = time_s[order], values[order]
        # The incomplete bin is that of the newest sample; all earlier bins are complete.
        edge = np.floor(time_s[-1] / self.bin_s + 1e-9) * self.bin_s - 1e-9 * self.bin_s
        cut = int(np.searchsorted(time_s, edge))
        self._time_s, self._values = time_s[cut:], values[cut:]
        return decimate(time_s[:cut], values[:cut], self.bin_s, self.reduce)

    def flush(self) -> tuple[Floats, Floats]:
        """Return the decimated incomplete bin; for use after a pause in the data."""
        time_s, values = self._time_s, self._values
        self._time_s = self._values = np.empty(0)
        return decimate(time_s, values, self.bin_s, self.reduce)

    @property
    def waiting(self) -> bool:
        """True while an incomplete bin is kept."""
        return len(self._time_s) > 0
