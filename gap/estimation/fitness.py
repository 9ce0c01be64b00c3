"""Whether the nominal plant fits a data set at all.

Effects are corrections of a plant that is nearly right. Where lengths lie outside what the braid
can reach, the plant is that of another muscle: whatever a search finds then says nothing. Where the
recalibrated plant misses most of what was read, or would need constants far off, it may be another
muscle too, or several large effects at once. Then the search decides: the plant is in doubt, and
the doubt stays unless effects explain nearly all of the gap and leave neither finding.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import partial

import numpy as np

from gap.effects.candidates import Candidate
from gap.estimation.config import ESTIMATION, EstimationConfig
from gap.estimation.fit_problem import FitProblem, FitResult
from gap.model.features import BLOCKS, UNITS
from gap.model.force import muscle_force
from plant.arrays import Array
from plant.constants import STANDARD_GRAVITY_M_S2
from plant.effects.arguments import Points


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


def beyond_braid(problem: FitProblem, config: EstimationConfig = ESTIMATION) -> list[UnfitPlant]:
    """Lengths that no muscle of the nominal plant has: with them nothing can be diagnosed."""
    return list(_lengths(problem, config))


def doubts(
    problem: FitProblem, fit: FitResult, config: EstimationConfig = ESTIMATION
) -> list[UnfitPlant]:
    """Findings that speak against the nominal plant at a fit, such as the recalibrated plant."""
    return [*_readings(problem, fit, config), *_constants(problem, fit, config)]


def doubts_left(
    problem: FitProblem,
    fit: FitResult,
    gap: float,
    left: float,
    config: EstimationConfig = ESTIMATION,
) -> list[UnfitPlant]:
    """What still speaks against a plant that was in doubt, once effects explain its gap.

    Args:
        fit: with the effects that explain it.
        gap: chi-square of the recalibrated plant beyond the number of rows.
        left: the same of `fit`.

    Returns:
        Findings at the recalibrated plant where the effects leave more than a small part of the
        gap, where a fault of the recording is among them, or where another muscle explains what
        one of them does; else those at `fit`. Empty where the doubt is gone.
    """
    stated = doubts(problem, problem.base, config)
    faulty = any(candidate.defect for candidate in fit.candidates)
    if (
        faulty
        or left > config.doubt_left * gap
        or _is_another_muscle(problem, fit, gap, left, config)
    ):
        return stated
    return doubts(problem, fit, config)


def _is_another_muscle(
    problem: FitProblem, fit: FitResult, gap: float, left: float, config: EstimationConfig
) -> bool:
    """Whether a muscle of other length and turns does what the effects do, or one of them.

    Such an effect may only stand for it: without the effect, more is left of the nominal muscle
    and not of the other one. What takes a small part of the gap stands for no muscle. Nor does an
    effect without which the other muscle leaves more than a small part of the gap, if with the
    effects the muscle stays what it is: the data then hold no other one.
    """
    other = problem.with_free_constants(_MUSCLE, config.another_muscle)
    if (other.base.cost - len(problem.rows)) * config.doubt_left < left:
        return True
    whole = _best_fit(other, _in_sd_of(other, problem, fit.shift), *fit.kept(lambda _: True))
    # Where length and turns are free to go, do the data ask for others beside the effects?
    moved = replace(whole, shift=_in_sd_of(problem, other, whole.shift))
    near = not any(_constants(problem, moved, config))
    for name in fit.ids:
        kept = fit.kept(partial(_is_other, name))
        lost = _best_fit(problem, fit.shift, *kept).cost - fit.cost
        if lost < config.doubt_left * gap:
            continue
        other_lost = _best_fit(other, whole.shift, *kept).cost - whole.cost
        alike = not near or other_lost < config.doubt_left * gap
        if alike and other_lost < config.stands_for_muscle * lost:
            return True
    return False


def _in_sd_of(other: FitProblem, problem: FitProblem, shift: Array) -> Array:
    """Constants in the sd of another problem, in which those of the muscle are wider."""
    sd, wide = problem.data.constants.tolerance_si, other.data.constants.tolerance_si
    muscle = [n in _MUSCLE and sd(n) > 0.0 for n in problem.names]
    return np.array(
        [
            s * sd(name) / wide(name) if own else s
            for name, own, s in zip(problem.names, muscle, shift.tolist(), strict=True)
        ]
    )


def _best_fit(
    problem: FitProblem, shift: Array, candidates: list[Candidate], amounts: list[float]
) -> FitResult:
    """The better of the fits from given constants and from the recalibrated ones.

    The recalibrated ones have given way to the effects: a fit from there may end far from the best.
    """
    near = problem.polish(problem.fit_from(shift, candidates, amounts))
    afresh = problem.polish(problem.fit(candidates, amounts))
    return near if near.cost <= afresh.cost else afresh


def _is_other(name: str, candidate: Candidate) -> bool:
    return candidate.id != name


def _lengths(problem: FitProblem, config: EstimationConfig) -> Iterator[UnfitPlant]:
    """Lengths beyond the braid, where the built-in muscle or chamber uses them."""
    braid = problem.data.constants.braid_length_m
    for block, points in problem.grid.points.items():
        if block == "camera" or problem.model.covers(block) or not len(points.length):
            continue
        longest = float(np.nanmax(points.length))
        if longest > (1.0 + config.beyond_braid) * braid:
            yield UnfitPlant(Misfit.LENGTHS, block, longest * 1e3, braid * 1e3)


def _constants(
    problem: FitProblem, fit: FitResult, config: EstimationConfig
) -> Iterator[UnfitPlant]:
    """Constants of muscle or simulator that the data move beyond anything a bench could be off."""
    own = [
        (abs(float(sd)), name)
        for name, sd in zip(problem.names, fit.shift, strict=True)
        if name in _MUSCLE or name.startswith(_SIMULATOR)
    ]
    far, name = max(own, default=(0.0, ""))
    if far > config.far_sd:
        yield UnfitPlant(Misfit.CONSTANTS, name, far, config.far_sd)


_MUSCLE = ("braid_length_mm", "turns", "piston_area_mm2")
_SIMULATOR = "simulator "


def _readings(
    problem: FitProblem, fit: FitResult, config: EstimationConfig
) -> Iterator[UnfitPlant]:
    """Forces and loads of which the plant misses most."""
    rows = problem.rows
    for block in ("force", "load"):
        points = problem.grid.points.get(block)
        if points is None:
            continue
        here = rows.block == BLOCKS.index(block)
        read = points.reading if block == "force" else _full_load(problem, fit, points)
        usual = float(np.sqrt(np.average(read**2, weights=points.weight)))
        residual = fit.residual[here]
        off = float(np.sqrt(np.average(residual**2, weights=rows.samples[here])))
        if off > config.misfit_share * usual:
            yield UnfitPlant(Misfit.READINGS, block, off, usual)


def _full_load(problem: FitProblem, fit: FitResult, points: Points) -> Array:
    """Load in N that an error of the muscle is compared with, one value a point.

    A muscle under a small weight is near the length at which it pulls nothing: what it would pull
    held at its longest is what another muscle is off from. A slide's friction may be larger than
    the weight.
    """
    hung = points.mass * STANDARD_GRAVITY_M_S2
    if problem.model.covers("load"):
        return np.asarray(hung)
    held = replace(points, length=np.full(len(points.length), np.nanmax(points.length)))
    context = problem.model.context(problem.constants(fit.shift), [])
    return np.maximum(hung, muscle_force(held, [], context))
