"""Where signals are compared (points), and the features they are reduced to (rows)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gap.data.dataset import Array

Whole = npt.NDArray[np.int64]

BLOCKS = ("pressure", "force", "load", "camera")
UNITS = {"pressure": "kPa", "force": "N", "load": "N", "camera": "mm"}


@dataclass(frozen=True)
class Points:
    """Instants at which one block is compared, all trials one after the other; SI.

    Attributes:
        first: points of trial t are first[t]:first[t + 1].
        mounting: number of the mounting each point was taken in.
        row: feature row each point belongs to, counted within the block.
        weight: samples that each point stands for.
        path: pressure without its sampling noise, for what depends on turning points.
        held: whether the length is the one written down, not one that was read.
        settled: whether the trial is a table of settled points, whose `time_s` counts its rows.
        reading: measured output: force in N, pressure in Pa or length in m.
    """

    first: Whole
    trial: Whole
    mounting: Whole
    time_s: Array
    row: Whole
    weight: Array
    pressure: Array
    pressure_slope: Array
    path: Array
    length: Array
    rate: Array
    acceleration: Array
    held: npt.NDArray[np.bool_]
    settled: npt.NDArray[np.bool_]
    temperature: Array
    mass: Array
    reading: Array
    direction: Array


@dataclass(frozen=True)
class Rows:
    """What each feature row is: block, trial, mean time, samples, slot-wide bin number.

    `doubt` is what the length's interpolation between frames may cost, in the block's unit (kPa,
    N, mm), `adrift` what gas that passed unseen may make of the pressure (kPa, one error
    throughout a trial), `floor` what no model of this kind gets right.
    """

    block: Whole
    trial: Whole
    time_s: Array
    samples: Array
    span_s: Array
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
        bin=whole("bin").astype(np.int64),
        pressure=whole("pressure"),
        length=whole("length"),
        rate=whole("rate"),
        doubt=whole("doubt"),
        adrift=whole("adrift"),
        floor=whole("floor"),
    )
