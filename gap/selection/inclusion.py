"""When one more effect counts: what it takes, where it shows, and what the first one left.

What is left of a first effect whose form is not exact can be taken by many others. So a further
effect must be seen over the floor, and take a fair share of the gap unless it shows in channels of
its own or the first one leaves nothing.
"""

from __future__ import annotations

import numpy as np

from gap.estimation.fit_problem import FitProblem, FitResult

SHARE_SURE = 0.06
"""Least share of the gap's excess that a further effect must take away."""
SEEN_NEXT = 0.6
"""Least change of the residual in some block, in units of its floor, for an effect to count."""
FAR_ABOVE = 3.0
"""The same, from which a further effect counts beside one whose form leaves much."""
PLAINLY_SEEN = 1.5
"""The same, from which an effect counts beside one of any size."""
PLAIN_GAIN = 240.0
PLAIN_SHARE = 0.1
PLAIN_OF_LEFT = 0.6
"""Gain, share of the gap and share of what is left from which less over the floor will do:"""
PLAIN_SEEN = 0.4
SETTLED = 0.9
SETTLED_GAIN = 450.0
SETTLED_SHARE = 0.02
"""Share of what is left, gain and share of the gap from which two explain all there is."""
SHOWS = 0.1
"""Least change of the residual, in units of its floor, that is any at all."""
AT_THE_END = 2.9
BACK = 2.4
"""Shift of a constant, in sd, that an effect left out may have bent, and that none has to have."""
RELEASE_GAIN = 120.0
"""Gain from which an effect counts that brings such constants back."""
RELIEF = 2.0
RELIEVED = 3.0
"""Drop of the largest shift, in sd, and what it must have come down to, for constants that an
effect relieves."""
ALL_THAT_IS_LEFT = 0.97
ALL_GAIN = 1000.0
"""Share of what is left and gain from which the share of the gap does not matter."""
_LEAST_NEXT = 40.0


def excess_chi2(problem: FitProblem, fit: FitResult) -> float:
    """Whitened sum of squares beyond what noise alone leaves."""
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


def apart(problem: FitProblem, fit: FitResult, key: str) -> bool:
    """Whether the effect of `key` shows in channels that no other effect in force touches."""
    own = next(s.blocks for s in problem.candidates if s.key == key)
    others = {b for s in fit.candidates if s.key != key for b in s.blocks}
    return not set(own) & others & set(problem.grid.points)


def passes_inclusion_test(
    problem: FitProblem, gap: float, alarm: float, before: FitResult, key: str, after: FitResult,
    relative: float = np.inf,
) -> bool:  # fmt: skip
    """Whether a further effect of `key` takes away enough to count as one more.

    `gap` is the whitened gap beyond noise at the base, `alarm` what a first effect needs,
    `relative` the cost with the best relative of those in force instead, which mends their form.
    """
    gain = before.cost - after.cost
    if gain < max(_LEAST_NEXT, alarm):
        return False
    if after.cost < relative and (
        leaves_nothing(problem, gap, before, after) or frees_constants(problem, before, after)
    ):  # fmt: skip
        return True
    visible = visibility(problem, before, after)
    if visible > PLAIN_SEEN and plain(problem, gap, before, gain):
        return True
    if visible <= SEEN_NEXT:
        return False
    return apart(problem, before, key) or _worth(problem, gap, alarm, before, after)


def plain(problem: FitProblem, gap: float, before: FitResult, gain: float) -> bool:
    """Whether it takes most of what is left, and much of the gap.

    `gap` is the whitened gap beyond noise at the base. Such an effect may show in few moments
    only, as a valve's does, and stand less high over a floor that is a mean over all of them.
    """
    return gain > max(PLAIN_GAIN, PLAIN_SHARE * gap, PLAIN_OF_LEFT * excess_chi2(problem, before))


def leaves_nothing(problem: FitProblem, gap: float, before: FitResult, after: FitResult) -> bool:
    """Whether both together leave nothing where one of another family left much.

    `gap` is the whitened gap beyond noise at the base. What an inexact form leaves, another effect
    mends in part; that it takes all of it, and not through one family's likeness, is no accident.
    """
    gain = before.cost - after.cost
    left = excess_chi2(problem, before)
    # A first effect may be a thousand times the second: then all there is counts, not its share;
    # and where it leaves nothing, its form has nothing to mend.
    everything = gain > max(ALL_GAIN, ALL_THAT_IS_LEFT * left)
    exact = left < np.sqrt(2.0 * len(problem.rows))
    share = 0.0 if everything or exact else SETTLED_SHARE
    if gain < max(SETTLED_GAIN, share * gap, SETTLED * left):
        return False
    return not same_family(before, after) and visibility(problem, before, after) > SHOWS


def _worth(
    problem: FitProblem, gap: float, alarm: float, before: FitResult, after: FitResult
) -> bool:
    """Whether it takes a fair share of the gap or of what is left.

    What is left of a first effect whose form is not exact can be taken by many others; that shows
    over a floor nowhere, and is little of the gap.
    """
    visible = visibility(problem, before, after)
    gain = before.cost - after.cost
    left = max(excess_chi2(problem, before), 1.0)
    if gain > SHARE_SURE * gap:
        return True
    if left < 2.0 * np.sqrt(2.0 * len(problem.rows)) and gain > 1.5 * max(_LEAST_NEXT, alarm):
        return True  # nothing is left of the first effect that a second could mend
    if visible > FAR_ABOVE and gain > 0.15 * left:
        return True
    if visible > PLAINLY_SEEN and gain > 0.2 * left:
        return True
    if gain < 0.35 * left:
        return False
    large = left > 0.02 / 0.35 * gap
    return visible > PLAINLY_SEEN or large


def frees_constants(problem: FitProblem, before: FitResult, after: FitResult) -> bool:
    """Whether constants that stood at the end of their tolerance come back from it.

    Such an effect may show nowhere, because constants had taken its place, and at a price.
    """
    gain = before.cost - after.cost
    if gain < max(RELEASE_GAIN, PLAIN_OF_LEFT * excess_chi2(problem, before)) or same_family(
        before, after
    ):
        return False
    then, now = np.abs(before.shift), np.abs(after.shift)
    back = np.any((then > AT_THE_END) & (now < BACK))
    return bool(back and not np.any((then < BACK) & (now > AT_THE_END)))


def relieves_constant(before: FitResult, after: FitResult) -> bool:
    """Whether the constant that was bent most comes back a good way, and at a price.

    Held-out data cannot tell such an effect from the constants that had taken its place.
    """
    if before.cost - after.cost < RELEASE_GAIN or same_family(before, after):
        return False
    drop = largest_shift(before) - largest_shift(after)
    return drop > RELIEF and largest_shift(after) < RELIEVED


def same_family(before: FitResult, after: FitResult) -> bool:
    """Whether the last effect is of the family of another in force, and may only mend its form."""
    return after.candidates[-1].family in {candidate.family for candidate in before.candidates}


def largest_shift(fit: FitResult) -> float:
    """Largest shift of a constant, in sd."""
    return float(np.abs(fit.shift).max(initial=0.0))


def inclusion_record(
    problem: FitProblem,
    gap: float,
    alarm: float,
    before: FitResult,
    key: str,
    after: FitResult,
    counted: bool,
) -> dict[str, float | str]:
    """What speaks for one more effect, in plain numbers, and whether it counted."""
    gain = before.cost - after.cost
    return {
        "key": key,
        "gain": gain,
        "bent": largest_shift(before),
        "bent_after": largest_shift(after),
        "alarm": alarm,
        "share": gain / max(gap, 1.0),
        "of_left": gain / max(excess_chi2(problem, before), 1.0),
        "left": excess_chi2(problem, before),
        "rows": float(len(problem.rows)),
        "seen": visibility(problem, before, after),
        "apart": float(apart(problem, before, key)),
        "same_family": float(same_family(before, after)),
        "counted": float(counted),
    }
