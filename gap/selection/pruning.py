"""What a search found, cleared of defects of the recording and of effects it could do without.

A defect of the recording bends to much that has nothing to do with it. It may stand as the answer
only where it explains the gap alone and every trial asks for the same amount of it; otherwise the
search is made again among effects alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.stats import t as student

from gap.estimation.cross_validation import HeldOut, held_out
from gap.estimation.fit_problem import FitProblem, FitResult
from gap.selection.forward import PLAIN, SearchResult, search_effects
from gap.selection.inclusion import (
    PLAINLY_SEEN,
    apart,
    excess_chi2,
    leaves_nothing,
    plain,
    relieves_constant,
    visibility,
)
from gap.selection.refine import Hypothesis

Array = npt.NDArray[np.float64]

ALONE = 0.75
"""Least share of the gap's excess that a defect must take away alone."""
SAME = 0.15
"""Most that trials may differ in the amount they ask for, beyond chance, over that amount."""
FAR_WORSE = 0.1
"""Share of the gap's excess by which effects may do worse than a defect and still be named."""
LEAST_LATE_MS = 5.0
"""Delay below which a late channel may as well be a slow sensor, which no clock is to blame for."""
SURE = 0.95
FORM = 0.12
"""Share of what is explained below which a further effect in the same channels only mends the
form of the one before."""
SECOND = 1.25
"""Gain, in units of a first effect's alarm, from which one needs no other proof in channels that
no other touches, beside one that leaves nothing: there it is a first effect."""
LARGE = 0.2
"""Share of the gap from which a further effect needs no held-out proof."""


@dataclass(frozen=True)
class PruningResult:
    """The search's outcome among effects alone.

    Attributes:
        naming: outcome without any defect, unless `defect`.
        defect: whether a defect of the recording is the answer.
        blurred: whether a defect, though not certain, explains far more than any effect.
    """

    search: SearchResult
    defect: bool = False
    blurred: bool = False


def prune(problem: FitProblem, search: SearchResult) -> PruningResult:
    """Take defects and needless effects out of what a search found."""
    candidates = search.best.fit.candidates
    if not any(candidate.defect for candidate in candidates):
        return PruningResult(_needed(problem, _rivals_cleared(search)))
    first = candidates[0].defect
    if first and _is_defect(problem, search):
        return PruningResult(search, defect=True)
    clean = search_effects(problem.restricted_to(lambda candidate: not candidate.defect))
    worse = clean.best.cost - search.best.cost
    blurred = first and worse > PLAIN + FAR_WORSE * search.excess_chi2
    return PruningResult(_needed(problem, _rivals_cleared(clean)), blurred=blurred)


def _rivals_cleared(search: SearchResult) -> SearchResult:
    rivals = [c for c in search.rivals if not any(s.defect for s in c.fit.candidates)]
    return replace(search, rivals=rivals)


def _is_defect(problem: FitProblem, search: SearchResult) -> bool:
    if search.steps[0][1] < max(ALONE * search.excess_chi2, PLAIN):
        return False
    fit = search.best.fit
    late = float(fit.amounts[0])
    if fit.candidates[0].id.endswith("clock") and 0.0 < late < LEAST_LATE_MS:
        return False
    return _disagreement(problem, fit) < SAME * abs(float(fit.amounts[0]))


def _disagreement(problem: FitProblem, fit: FitResult) -> float:
    """Spread over trials, beyond chance, of the amount of the first candidate each asks for."""
    slope = problem.slopes(fit.shift, fit.candidates, fit.amounts)[:, 0]
    asked, weight = [], []
    for trial, rows in enumerate(problem.noise.trial_rows):
        if len(rows):
            gram, _ = problem.noise.solve(
                trial, np.stack([slope[rows], fit.residual[rows]], axis=1)
            )
            if gram[0, 0] > 0.0:
                asked.append(gram[0, 1] / gram[0, 0])
                weight.append(gram[0, 0])
    if not weight:
        return float("inf")
    d, w = np.array(asked), np.array(weight)
    return float(np.sqrt(max(float(w @ d**2) - len(d), 0.0) / w.sum()))


def _needed(problem: FitProblem, search: SearchResult) -> SearchResult:
    """Strike further effects, last first, whose own gain on held-out slots is not certain."""
    while len(keys := search.best.keys) > 1:
        fit = search.best.fit
        gain = search.steps[-1][1]
        elsewhere = apart(problem, fit, keys[-1])
        if elsewhere and gain > PLAIN:
            break
        pairs = [
            (candidate, float(amount))
            for candidate, amount in zip(fit.candidates, fit.amounts, strict=True)
            if candidate.key != keys[-1]
        ]
        less = problem.polish(problem.fit([s for s, _ in pairs], [a for _, a in pairs], fit))
        if plain(problem, search.excess_chi2, less, gain) or leaves_nothing(
            problem, search.excess_chi2, less, fit
        ):
            break  # it may show in few slots only, where no mean over slots is certain
        exact = excess_chi2(problem, less) < 2.0 * np.sqrt(2.0 * len(problem.rows))
        if relieves_constant(less, fit) or (elsewhere and exact and gain > SECOND * search.alarm):
            break
        part = gain < FORM * max(problem.base.cost - fit.cost, 1.0)
        mends = part and not (elsewhere or exact) and visibility(problem, less, fit) < PLAINLY_SEEN
        if not mends and (
            gain > LARGE * search.excess_chi2
            or _gains_surely(held_out(problem, less), held_out(problem, fit))
        ):
            break
        search = replace(
            search, best=Hypothesis(keys[:-1], less), rivals=[], steps=search.steps[:-1],
            left=excess_chi2(problem, less),
        )  # fmt: skip
    return search


def _gains_surely(less: dict[str, HeldOut], more: dict[str, HeldOut]) -> bool:
    """Whether some block's held-out error falls for certain, over units, with the fuller state."""
    for block, held in more.items():
        use = held.weight > 0.0
        gain = (less[block].after - held.after)[use]
        if len(gain) < 3:
            return True
        error = float(gain.std(ddof=1) / np.sqrt(len(gain)))
        if float(gain.mean()) > float(student.ppf(SURE, len(gain) - 1)) * error:
            return True
    return False
