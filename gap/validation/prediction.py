"""Whether an explanation found on earlier trials predicts trials that were not used to find it.

Its amounts stay as they were found; the constants of the plant are recalibrated within their
tolerances. A right explanation leaves of the new trials what noise leaves. One that was fitted to a
wrong cause does not, and a rival that fitted the earlier trials as well mostly leaves more.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from gap.estimation.fit_problem import FitProblem, FitResult
from gap.selection.candidate_fits import Hypothesis, fit_further, in_best_form, linear_gains
from gap.selection.search import SearchResult
from gap.validation.config import VALIDATION
from plant.arrays import Array
from plant.effects.catalogue import CATALOGUE


@dataclass(frozen=True)
class Prediction:
    """What new trials have left beyond noise, as whitened sums of squares.

    Attributes:
        rows: features of the new trials.
        without: left by the recalibrated plant.
        left: left with the explanation as it was found before.
        rivals: the same of each rival, by its ids.
    """

    rows: int
    without: float
    left: float
    rivals: dict[tuple[str, ...], float]

    @property
    def share(self) -> float:
        """Share of the gap that is taken away; what chance may leave does not count as left."""
        chance = self.rows + float(np.sqrt(2.0 * self.rows))
        return 1.0 - max(self.left - chance, 0.0) / max(self.without - self.rows, 1.0)

    @property
    def shown(self) -> bool:
        """Whether the new trials have anything to say about the explanation."""
        return abs(self.without - self.left) > VALIDATION.shown_chi2

    @property
    def confirmed(self) -> bool:
        """Whether the new trials came out as predicted, and as no rival predicted them."""
        return self.gained > VALIDATION.shown_chi2 and self.share >= VALIDATION.predicted_share

    @property
    def outpredicts(self) -> bool:
        """Whether it predicts more than half of the gap, and every rival leaves a multiple of what
        it leaves: the right explanation in an inexact form.
        """
        beyond = max(self.left - self.rows, float(np.sqrt(2.0 * self.rows)))
        by_rivals = self.gained + self.left - self.rows
        return (
            self.gained > VALIDATION.shown_chi2
            and self.share >= VALIDATION.refuted_share
            and by_rivals > VALIDATION.outpredicted * beyond
        )

    @property
    def gained(self) -> float:
        """Whitened squares that it takes away beyond what the nearest rival does."""
        return min([self.without, *self.rivals.values()]) - self.left

    @property
    def refuted(self) -> bool:
        """Whether the new trials speak against the explanation."""
        return self.shown and self.share < VALIDATION.refuted_share


def predict_trials(
    problem: FitProblem, trials: Collection[int], fit: FitResult, rivals: Iterable[FitResult]
) -> Prediction:
    """How well the explanation `fit` and its rivals predict trials that were not used to find it.

    Args:
        problem: all data, the new trials included.
        trials: which are new.
        state: found on data without them, perhaps by another fit problem.
        rivals: other explanations of the same data; fitted only where the trials show anything.
    """
    found = Prediction(
        sum(len(problem.noise.trial_rows[trial]) for trial in trials),
        _left_by(problem, problem.base, trials),
        _left_by(problem, _fixed(problem, fit), trials),
        {},
    )
    if found.shown:
        found.rivals.update(
            {rival.ids: _left_by(problem, _fixed(problem, rival), trials) for rival in rivals}
        )
    return found


def rivals_of(
    problem: FitProblem, search: SearchResult, entries: Iterable[tuple[str, ...]] = ()
) -> Iterator[FitResult]:
    """What an explanation of `problem` must predict new trials better than.

    Without any one of its families, where it has several; then the nearest explanations by other
    families and the other entries of the verdict, fitted now where the search had no need to.
    """
    best = search.best.fit
    own = families(best.ids)
    for family in sorted(own) if len(own) > 1 else ():
        rest = best.kept(lambda candidate, gone=family: candidate.family != gone)  # type: ignore[misc]
        yield problem.polish(problem.fit(*rest))
    covered: set[str] = set()
    others = [
        hypothesis.fit for hypothesis in search.rivals if not own & families(hypothesis.fit.ids)
    ]
    for fit in others[: VALIDATION.most_rivals]:
        covered |= families(fit.ids)
        yield fit
    held = [families(fit.ids) for fit in others[: VALIDATION.most_rivals]]
    for ids in entries:
        other = families(ids)
        if other & own or other in held:
            continue
        covered |= other
        yield problem.polish(problem.fit_effects(ids))
    base = Hypothesis((), problem.base)
    linear = linear_gains(problem, base.fit)
    for key in sorted(search.first_gain, key=lambda key: -search.first_gain[key]):
        if len(covered) >= VALIDATION.least_rivals:
            return
        other = families((key.partition(":")[0],))
        if not other or other & (own | covered):
            continue
        covered |= other
        first = fit_further(problem, base, key, linear)
        yield problem.polish(in_best_form(problem, base.fit, first, linear).fit)


def families(ids: Collection[str]) -> frozenset[str]:
    """Families of the catalogue's entries among `ids`; defects of a recording have none."""
    return frozenset(CATALOGUE[name].family for name in ids if name in CATALOGUE)


def margins(problem: FitProblem, fit: FitResult, others: Sequence[FitResult]) -> Array:
    """What others leave of each trial more than `fit`, shape (others, trials).

    All are fitted to `problem`; in whitened squares.
    """
    trials = range(len(problem.data.trials))
    own = np.array([_left_by(problem, fit, [trial]) for trial in trials])
    left = [[_left_by(problem, other, [trial]) for trial in trials] for other in others]
    return np.asarray(np.array(left).reshape(len(others), len(own)) - own)


def _fixed(problem: FitProblem, fit: FitResult) -> FitResult:
    """Constants recalibrated on all of `problem` with the effects of `fit` as they were found."""
    other = problem.with_stated_effects(fit.active)
    return other.polish(other.fit(()))


def _left_by(problem: FitProblem, fit: FitResult, trials: Collection[int]) -> float:
    total = 0.0
    for trial in trials:
        rows = problem.noise.trial_rows[trial]
        if len(rows):
            total += float(problem.noise.solve(trial, fit.residual[rows][:, None])[0][0, 0])
    return total
