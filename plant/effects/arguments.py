"""What the functions of effects are given."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from plant.constants import PlantConstants
from plant.effects.reference import FULL_PRESSURE_PA, TEMPERATURE_C, TYPICAL_FORCE_N

Values = Mapping[str, float | str]
"""The parameters of an effect in force, by name, in the units of their names."""
Shape = Mapping[str, float]
"""Numbers that pick one of the forms in which the diagnosis tries an effect."""
Params = Any
"""Array of numbers by slot: of the plant, or of the pressure stage of the diagnosis."""
Array = Any
"""Floats or float64 arrays: in compiled code one number, elsewhere one a sample."""
Floats = npt.NDArray[np.float64]
Whole = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]


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
        taken: when a settled point was read, s from when the muscle was brought to the first one of
            its trial; NaN where unknown and of trials with time.
        clipped: whether the pressure stands at the lower end of what its gauge can show: no more is
            known of it than that it is not above.
    """

    first: Whole
    trial: Whole
    mounting: Whole
    time_s: Floats
    row: Whole
    weight: Floats
    pressure: Floats
    pressure_slope: Floats
    path: Floats
    length: Floats
    rate: Floats
    rate_sd: Floats
    acceleration: Floats
    held: npt.NDArray[np.bool_]
    settled: npt.NDArray[np.bool_]
    temperature: Floats
    mass: Floats
    reading: Floats
    direction: Floats
    taken: Floats
    clipped: npt.NDArray[np.bool_]

    @cached_property
    def known_reading(self) -> Floats:
        """The reading of the pressure, NaN where it is clipped."""
        return np.where(self.clipped, np.nan, self.reading)

    @cached_property
    def row_weight(self) -> Floats:
        """Sum of the weights of each row's points."""
        return np.bincount(self.row, weights=self.weight).astype(np.float64, copy=False)

    @cached_property
    def row_start(self) -> Whole | None:
        """First point of each row; None where the points of a row do not all follow each other."""
        step = np.diff(self.row)
        if not len(self.row) or np.any(step < 0):
            return None
        return np.asarray(np.r_[0, np.flatnonzero(step) + 1], dtype=np.int64)


@dataclass(frozen=True)
class Context:
    """What a force needs beside the points.

    Attributes:
        order: of the trials, from 0.
        law: nominal pull in N at gauge pressure in Pa and length in m; None for that of the
            braid.
        room_c: temperature at which the nominal plant holds.
        full_n, full_pa: largest force and gauge pressure in the data, where the error of a scale
            that bends is stated.
    """

    constants: PlantConstants
    order: Array
    law: Callable[[Array, Array], Array] | None = None
    room_c: float = TEMPERATURE_C
    full_n: float = TYPICAL_FORCE_N
    full_pa: float = FULL_PRESSURE_PA
