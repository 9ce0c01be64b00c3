"""From 1 kHz to what a screen can show: both extremes of every bin, so that spikes stay."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from daq.live.layout import Reduce

Floats = npt.NDArray[np.float64]


def decimate(
    time_s: Floats, values: Floats, bin_s: float, reduce: Reduce = "minmax"
) -> tuple[Floats, Floats]:
    """Thin a curve to at most two points a bin ("minmax") or one ("mean").

    Args:
        time_s: (n,) s, not decreasing.
        values: (n,); samples that are not finite are left out.
        bin_s: width of a bin, s; bins stand on multiples of it, so that the result does
            not depend on how the samples were batched as long as bins are not split.
        reduce: "minmax" keeps the lowest and highest sample of each bin at their own times;
            "mean" gives the mean at the mean time.

    Returns:
        time_s and values of the thinned curve, in order of time.
    """
    good = np.isfinite(values) & np.isfinite(time_s)
    if not good.all():
        time_s, values = time_s[good], values[good]
    if len(time_s) == 0:
        return time_s, values
    bins = np.floor(time_s / bin_s + 1e-9).astype(np.int64)
    first = np.flatnonzero(np.concatenate(([True], bins[1:] != bins[:-1])))
    if len(first) == len(bins):  # one sample a bin already
        return time_s, values
    if reduce == "mean":
        count = np.diff(np.append(first, len(bins)))
        return np.add.reduceat(time_s, first) / count, np.add.reduceat(values, first) / count
    order = np.lexsort((values, bins))  # within a bin: lowest first, highest last
    last = np.append(first[1:], len(bins)) - 1
    keep = np.unique(np.concatenate((order[first], order[last])))
    return time_s[keep], values[keep]


class Thinner:
    """Thins a curve that arrives in batches, holding the unfinished bin back.

    Args:
        bin_s: width of a bin, s.
        reduce: see ``decimate``.
    """

    def __init__(self, bin_s: float, reduce: Reduce = "minmax") -> None:
        self.bin_s = bin_s
        self.reduce = reduce
        self._time_s = np.empty(0)
        self._values = np.empty(0)

    def feed(self, time_s: Floats, values: Floats) -> tuple[Floats, Floats]:
        """Add samples; returns the thinned part that is complete."""
        if len(self._time_s):
            time_s = np.concatenate((self._time_s, time_s))
            values = np.concatenate((self._values, values))
        if len(time_s) == 0:
            return time_s, values
        if np.any(time_s[1:] < time_s[:-1]):
            order = np.argsort(time_s, kind="stable")
            time_s, values = time_s[order], values[order]
        # The open bin starts at the newest sample's bin; everything before it is complete.
        edge = np.floor(time_s[-1] / self.bin_s + 1e-9) * self.bin_s - 1e-9 * self.bin_s
        cut = int(np.searchsorted(time_s, edge))
        self._time_s, self._values = time_s[cut:], values[cut:]
        return decimate(time_s[:cut], values[:cut], self.bin_s, self.reduce)

    def flush(self) -> tuple[Floats, Floats]:
        """The unfinished bin, thinned; called when nothing has come for a while."""
        time_s, values = self._time_s, self._values
        self._time_s = self._values = np.empty(0)
        return decimate(time_s, values, self.bin_s, self.reduce)

    @property
    def waiting(self) -> bool:
        """True while samples are held back."""
        return len(self._time_s) > 0
