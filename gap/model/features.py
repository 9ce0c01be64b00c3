"""Where signals are compared (points), and the features they are reduced to (rows)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plant.arrays import Array
from plant.effects.arguments import Whole

BLOCKS = ("pressure", "force", "load", "camera")
UNITS = {"pressure": "kPa", "force": "N", "load": "N", "camera": "mm"}


@dataclass(frozen=True)
class Rows:
    """What each feature row is: block, trial, mean time, samples, slot-wide bin number.

    `span_s` is what a row stands for in its trial, `compared_s` the same in figures of a whole
    block (an error, a floor): none where frames cannot follow the swing of a load. What is read
    there means nothing, and would be most of such a figure.
    `doubt` is what the length's interpolation between frames may cost, in the block's unit (kPa,
    N, mm), `adrift` what gas that passed unseen may make of the pressure (kPa, one error
    throughout a trial), `floor` what no model of this kind gets right.
    """

    block: Whole
    trial: Whole
    time_s: Array
    samples: Array
    span_s: Array
    compared_s: Array
    bin: Whole
    pressure: Array
    length: Array
    rate: Array
    doubt: Array
    adrift: Array
    floor: Array

    def __len__(self) -> int:
        return len(self.trial)


@dataclass(frozen=True)
class Mean:
    """Weighted means over rows."""

    at: Whole
    weight: Array
    total: Array

    def __call__(self, x: Array) -> Array:
        """Means of x, one a point, over the points of each row."""
        return np.asarray(np.bincount(self.at, weights=x * self.weight) / self.total)


def stacked(rows: list[Rows]) -> Rows:
    """Rows of several pieces or blocks, one after the other."""

    def whole(name: str) -> Array:
        parts = [np.asarray(getattr(r, name)) for r in rows]
        return np.concatenate(parts) if parts else np.empty(0)

    return Rows(
        block=whole("block").astype(np.int64),
        trial=whole("trial").astype(np.int64),
        time_s=whole("time_s"),
        samples=whole("samples"),
        span_s=whole("span_s"),
        compared_s=whole("compared_s"),
        bin=whole("bin").astype(np.int64),
        pressure=whole("pressure"),
        length=whole("length"),
        rate=whole("rate"),
        doubt=whole("doubt"),
        adrift=whole("adrift"),
        floor=whole("floor"),
    )
