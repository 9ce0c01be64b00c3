"""Whether the nominal plant fits a data set at all, before anything is made of its gap.

Effects are corrections of a plant that is nearly right. Where lengths lie outside what the braid
can reach, or the recalibrated plant misses most of what was read, the plant is that of another
muscle: whatever a search finds then says nothing.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from gap.estimation.config import ESTIMATION, EstimationConfig
from gap.estimation.fit_problem import FitProblem
from gap.model.features import BLOCKS, UNITS
from plant.constants import STANDARD_GRAVITY_M_S2


class Misfit(StrEnum):
    """What shows that the nominal plant is not that of the data."""

    LENGTHS = "lengths"
    READINGS = "readings"
    CONSTANTS = "constants"


@dataclass(frozen=True)
class UnfitPlant:
    """One finding against the nominal plant.

    Attributes:
        misfit: its kind.
        place: block or constant where it shows.
        found, limit: length in mm and the longest the plant allows; the rms error of the
            recalibrated plant and the rms of what was read, in the block's unit; or sd by which
            a constant would have to be off and the most that is believed.
    """

    misfit: Misfit
    place: str
    found: float
    limit: float

    def __str__(self) -> str:
        if self.misfit is Misfit.LENGTHS:
            return f"a length of {self.found:.1f} mm on a braid of {self.limit:.1f} mm"
        if self.misfit is Misfit.CONSTANTS:
            return f"{self.place} would have to be off by {self.found:.0f} sd"
        unit = UNITS[self.place]
        return (
            f"the recalibrated plant is off by {self.found:.3g} {unit} rms in {self.place}, where "
            f"{self.limit:.3g} {unit} rms were read"
        )


def unfit_nominal(problem: FitProblem, config: EstimationConfig = ESTIMATION) -> list[UnfitPlant]:
    """Findings against the nominal plant of a data set; empty where it can be diagnosed."""
    return [*_lengths(problem, config), *_readings(problem, config), *_constants(problem, config)]


def _lengths(problem: FitProblem, config: EstimationConfig) -> Iterator[UnfitPlant]:
    """Lengths beyond the braid, where the built-in muscle or chamber uses them."""
    braid = problem.data.constants.braid_length_m
    for block, points in problem.grid.points.items():
        if block == "camera" or problem.model.covers(block) or not len(points.length):
            continue
        longest = float(np.nanmax(points.length))
        if longest > (1.0 + config.beyond_braid) * braid:
            yield UnfitPlant(Misfit.LENGTHS, block, longest * 1e3, braid * 1e3)


def _constants(problem: FitProblem, config: EstimationConfig) -> Iterator[UnfitPlant]:
    """Constants of muscle or simulator that the data move beyond anything a bench could be off."""
    own = [
        (abs(float(sd)), name)
        for name, sd in zip(problem.names, problem.base.shift, strict=True)
        if name in _MUSCLE or name.startswith("simulator ")
    ]
    far, name = max(own, default=(0.0, ""))
    if far > config.far_sd:
        yield UnfitPlant(Misfit.CONSTANTS, name, far, config.far_sd)


_MUSCLE = ("braid_length_mm", "turns")


def _readings(problem: FitProblem, config: EstimationConfig) -> Iterator[UnfitPlant]:
    """Forces and loads of which the recalibrated plant misses most."""
    rows = problem.rows
    for block in ("force", "load"):
        points = problem.grid.points.get(block)
        if points is None:
            continue
        here = rows.block == BLOCKS.index(block)
        read = points.reading if block == "force" else points.mass * STANDARD_GRAVITY_M_S2
        usual = float(np.sqrt(np.average(read**2, weights=points.weight)))
        residual = problem.base.residual[here]
        off = float(np.sqrt(np.average(residual**2, weights=rows.samples[here])))
        if off > config.misfit_share * usual:
            yield UnfitPlant(Misfit.READINGS, block, off, usual)
