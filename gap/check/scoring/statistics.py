"""Proportions with Wilson intervals, calibration of stated probabilities, limits of diagnosis."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

Floats = np.ndarray
Z95 = 1.959964


@dataclass(frozen=True)
class Share:
    """`hits` of `of`, with the Wilson interval at 95 %; `value` is nan for none of none."""

    hits: int
    of: int

    @property
    def value(self) -> float:
        """The proportion."""
        return self.hits / self.of if self.of else math.nan

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson score interval (Wilson, JASA 22 (1927) 209)."""
        if not self.of:
            return 0.0, 1.0
        p, n, z2 = self.value, self.of, Z95**2
        centre = (p + z2 / (2 * n)) / (1 + z2 / n)
        half = Z95 / (1 + z2 / n) * math.sqrt(p * (1 - p) / n + z2 / (4 * n * n))
        return max(centre - half, 0.0), min(centre + half, 1.0)

    def as_json(self) -> dict[str, float | int | None]:
        """Plain values; null for none of none."""
        low, high = self.interval
        return {
            "value": None if not self.of else round(self.value, 4),
            "low": round(low, 4),
            "high": round(high, 4),
            "hits": self.hits,
            "of": self.of,
        }


def share(flags: Sequence[bool]) -> Share:
    """How many of the flags are set."""
    return Share(int(sum(flags)), len(flags))


def bins_of(confidence: Floats, right: Floats, bins: int) -> list[tuple[float, float, int]]:
    """Mean confidence, share right and count in bins of equal width that hold anything."""
    place = np.minimum((confidence * bins).astype(int), bins - 1)
    found = []
    for b in range(bins):
        here = place == b
        if here.any():
            means = float(confidence[here].mean()), float(right[here].mean())
            found.append((*means, int(here.sum())))
    return found


def calibration_error(confidence: Floats, right: Floats, bins: int = 10) -> float:
    """Expected calibration error: mean distance of confidence and share right over the bins."""
    total = len(confidence)
    if not total:
        return math.nan
    return sum(abs(c - r) * n for c, r, n in bins_of(confidence, right, bins)) / total


_DRAWS = 400


def debiased_error(confidence: Floats, right: Floats) -> float:
    """Calibration error less what perfectly calibrated confidences of this number would show.

    The bias is simulated: outcomes drawn with the stated confidences themselves. Not below 0.
    """
    if not len(confidence):
        return math.nan
    rng = np.random.default_rng(1)
    plain = calibration_error(confidence, right)
    fair = (rng.random((_DRAWS, len(confidence))) < confidence).astype(float)
    chance = [calibration_error(confidence, outcome) for outcome in fair]
    return max(plain - float(np.mean(chance)), 0.0)


def limit_of_diagnosis(ratios: Floats, right: Floats) -> float | None:
    """Smallest gap (in floors) from which on at least 90 % of the sets were named right.

    None where no such size is reached. Sizes are those that occur; at least two sets above.
    """
    order = np.argsort(ratios)
    sizes, hits = ratios[order], right[order]
    best = None
    for i in range(len(sizes) - 1, -1, -1):
        if hits[i:].mean() < 0.9:
            break
        if len(sizes) - i >= 2:
            best = float(sizes[i])
    return best
