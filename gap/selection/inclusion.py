"""The inclusion test: whether one more effect is needed beside those found.

The form of a first effect is never exact, and many others can take a part of what it leaves. So a
further effect must be seen above the floor, and take a fair share of the gap, unless it shows in
channels of its own, leaves nothing, or frees a constant.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gap.estimation.fit_problem import FitProblem, FitResult
from gap.selection.config import SELECTION, SelectionConfig


@dataclass(frozen=True)
class StepStatistics:
    """What one more effect does to a fit.

    Attributes:
        key: key of the effect.
        gain: drop of chi-square.
        gap: chi-square of the recalibrated plant beyond the number of rows.
        left: the same of the fit without the effect.
        rows: number of rows.
        alarm: gain that a first effect needs on these data.
        visibility: largest drop of the residual in a block, in units of its floor.
        own_channels: it shows in channels that no other effect touches.
        same_family: another effect of its family is there, whose form it may only correct.
        best_of_family: no effect of a family that is there leaves as little.
        shift_before: largest shift of a constant without it, in sd.
        shift_after: the same with it.
        frees: a constant came back from the end of its tolerance, and none went there.
    """

    key: str
    gain: float
    gap: float
    left: float
    rows: int
    alarm: float
    visibility: float
    own_channels: bool
    same_family: bool
    best_of_family: bool
    shift_before: float
    shift_after: float
    frees: bool

    @property
    def chance(self) -> float:
        """One sd of chi-square."""
        return float(np.sqrt(2.0 * self.rows))

    @property
    def of_left(self) -> float:
        """Share of what is left."""
        return self.gain / max(self.left, 1.0)

    def as_dict(self, included: bool) -> dict[str, float | str]:
        """The record that the verdict carries as evidence."""
        return {
            "key": self.key, "gain": self.gain, "bent": self.shift_before,
            "bent_after": self.shift_after, "alarm": self.alarm,
            "share": self.gain / max(self.gap, 1.0), "of_left": self.of_left, "left": self.left,
            "rows": float(self.rows), "seen": self.visibility, "apart": float(self.own_channels),
            "same_family": float(self.same_family), "counted": float(included),
        }  # fmt: skip


def excess_chi2(problem: FitProblem, fit: FitResult) -> float:
    """Chi-square of a fit beyond the number of rows."""
    return max(fit.cost - len(problem.rows), 0.0)


def visibility(problem: FitProblem, before: FitResult, after: FitResult) -> float:
    """Largest drop of the residual in any block: root of the drop in squares over the floor's."""
    rows = problem.rows
    best = 0.0
    for number in np.unique(rows.block).tolist():
        here = rows.block == number
        span = rows.span_s[here] / rows.span_s[here].sum()
        drop = float(span @ (before.residual[here] ** 2 - after.residual[here] ** 2))
        floor = float(span @ problem.floor_variance[here])
        best = max(best, drop / max(floor, 1e-12))
    return float(np.sqrt(best))


def own_channels(problem: FitProblem, fit: FitResult, key: str) -> bool:
    """Whether the effect of `key` shows in channels that no other effect of the fit touches."""
    own = next(s.blocks for s in problem.candidates if s.key == key)
    others = {b for s in fit.candidates if s.key != key for b in s.blocks}
    return not set(own) & others & set(problem.grid.points)


def same_family(before: FitResult, after: FitResult) -> bool:
    """Whether the last effect is of the family of another one in the fit."""
    return after.candidates[-1].family in {candidate.family for candidate in before.candidates}


def step_statistics(
    problem: FitProblem,
    gap: float,
    alarm: float,
    before: FitResult,
    after: FitResult,
    best_relative: float = np.inf,
    key: str = "",
    config: SelectionConfig = SELECTION,
) -> StepStatistics:
    """What the last effect of `after` does to the fit `before`.

    Args:
        gap: chi-square of the recalibrated plant beyond the number of rows.
        alarm: gain that a first effect needs.
        best_relative: cost with the best effect of a family that is there instead.
        key: key of the effect, if it is not the last one.
    """
    key = key or after.candidates[-1].key
    then, now = np.abs(before.shift), np.abs(after.shift)
    far, back = config.freed_from_sd, config.freed_to_sd
    freed = np.any((then > far) & (now < back)) and not np.any((then < back) & (now > far))
    return StepStatistics(
        key=key,
        gain=before.cost - after.cost,
        gap=gap,
        left=excess_chi2(problem, before),
        rows=len(problem.rows),
        alarm=alarm,
        visibility=visibility(problem, before, after),
        own_channels=own_channels(problem, before, key),
        same_family=same_family(before, after),
        best_of_family=after.cost < best_relative,
        shift_before=float(then.max(initial=0.0)),
        shift_after=float(now.max(initial=0.0)),
        frees=bool(freed),
    )


def is_included(s: StepStatistics, config: SelectionConfig = SELECTION) -> bool:
    """The inclusion test of a further effect."""
    if s.gain < s.alarm:
        return False
    if s.best_of_family and (leaves_nothing(s, config) or frees_constant(s, config)):
        return True
    if not (s.visibility > config.further_visibility or _needs_no_sight(s, config)):
        return False
    # What corrects a form does not take all that is left and bring a constant back as well.
    if s.frees and s.gain > max(config.all_gain, config.all_of_left * s.left):
        return True
    return s.own_channels or _takes_fair_share(s, config)


def leaves_nothing(s: StepStatistics, config: SelectionConfig = SELECTION) -> bool:
    """Whether nothing is left with it, where an effect of another family left much.

    Another effect can take a part of what an inexact form leaves, but not all of it by chance.
    """
    # Where the first effect leaves nothing, its form has nothing to correct.
    all_of_it = s.gain > max(config.all_gain, config.all_of_left * s.left)
    share = 0.0 if all_of_it or s.left < s.chance else config.nothing_share
    if s.gain < max(config.nothing_gain, share * s.gap, config.nothing_of_left * s.left):
        return False
    return not s.same_family and s.visibility > config.nothing_visibility


def frees_constant(s: StepStatistics, config: SelectionConfig = SELECTION) -> bool:
    """Whether a constant comes back from the end of its tolerance.

    Such an effect may show nowhere: the constant had taken its place, and at a price.
    """
    needed = max(config.freed_gain, config.most_of_left * s.left)
    return s.gain >= needed and s.frees and not s.same_family


def relieves_constant(s: StepStatistics, config: SelectionConfig = SELECTION) -> bool:
    """Whether the constant that was shifted most comes back a good way."""
    if s.gain < config.freed_gain or s.same_family:
        return False
    drop = s.shift_before - s.shift_after
    return drop > config.relief_sd and s.shift_after < config.relieved_sd


def _exact(s: StepStatistics) -> bool:
    """Whether the effects before leave nothing: there is no form that this one could correct."""
    return max(s.left, 1.0) < 2.0 * s.chance


def _needs_no_sight(s: StepStatistics, config: SelectionConfig) -> bool:
    """Whether an effect counts however little it takes from the rms of a whole block.

    An effect of the gas shows in the few rows in which a valve is open.
    """
    most = s.of_left > config.unseen_of_left and s.gain > config.further_share * s.gap
    return not s.same_family and (most or _exact(s))


def _takes_fair_share(s: StepStatistics, config: SelectionConfig) -> bool:
    """Whether an effect takes a fair share of the gap, or of what is left."""
    return (
        s.gain > config.further_share * s.gap
        or (_exact(s) and s.gain > config.exact_gain * s.alarm)
        or (s.visibility > config.plain_visibility and s.of_left > config.plain_of_left)
        or (
            s.visibility > config.fair_visibility
            and s.of_left > config.fair_of_left
            and s.gain > config.nothing_share * s.gap
        )
    )
