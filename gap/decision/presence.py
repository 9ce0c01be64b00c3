"""Presence: the probability of each effect of an explanation, whatever else acts beside it.

An explanation of many effects may be right in most of them and leave a rest that nobody has a name
for. So each effect is asked for by itself: how much worse is the best explanation without it, and
the best with another effect in its place? Both are measured by what the explanation leaves where
the effect acts: no form is exact, and what is left is the size of the model's own error. With such
an error the likelihood falls as a power of what an explanation leaves, so the odds of an effect are
a product of powers, and their logarithm is a sum. Its weights (`presence.toml`) were learnt
(`python -m gap.check.presence`) from sets of one to five effects and from sets whose effect is not
in the catalogue.

Explanations of as many effects are also compared with an unknown smooth error of the form of each
stage beside them (`gap.estimation.discrepancy`).
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import cache
from importlib import resources

import numpy as np
from scipy.special import expit

from gap.estimation.discrepancy import Discrepancy
from gap.estimation.fit_problem import FitProblem, FitResult
from gap.estimation.shape_fit import LOOSE, fit_shapes
from gap.model.features import BLOCKS
from gap.selection.backward import in_order, refitted_without, without
from gap.selection.candidate_fits import Hypothesis, fit_further, linear_gains
from gap.selection.inclusion import excess_chi2, visibility
from gap.selection.search import SearchResult
from plant.arrays import Array

STAND_INS = 2
"""Effects that are fitted in the place of one, best linear gain first."""
RIVALS = 4
"""Rivals of the search that are compared with the best explanation, best first."""
SURER = 3.0
"""Log evidence by which another explanation must be ahead to take the place of the best: odds of
twenty to one."""
_EXCHANGES = 3


@dataclass(frozen=True)
class Evidence:
    """What speaks for one effect of an explanation.

    Attributes:
        id: the effect.
        left: chi-square beyond the number of rows that the explanation leaves in the blocks where
            the effect acts, and one sd of it.
        gap: the same of the recalibrated plant.
        lost: rise of chi-square without the effect, all others fitted anew.
        margin: rise of chi-square with the best other effect in its place; `lost` where none.
        log_lost: fall of the log evidence without the effect, an unknown discrepancy beside both.
        log_margin: the same with the best other effect in its place; `log_lost` where none.
        slots: t-value over slots of the rise without it.
        visibility: what it takes from some block, in units of its floor.
        shape_at_end: whether the data hold a number of its shape at an end of its range.
        single: whether the explanation has no other effect.
    """

    id: str
    left: float
    gap: float
    lost: float
    margin: float
    log_lost: float
    log_margin: float
    slots: float
    visibility: float
    shape_at_end: float
    single: float

    def features(self) -> Array:
        """Bounded numbers of order one, in the order of `FEATURES`."""
        made = {
            "margin": np.clip(np.log10(self.margin / self.left + 0.01), -2.0, 1.5),
            "lost": np.clip(np.log10(self.lost / self.left + 0.1), -1.0, 2.0),
            "slots": np.clip(self.slots, 0.0, 4.0),
            "visibility": np.clip(np.log10(self.visibility + 0.05), -1.3, 1.0),
            "shape_at_end": self.shape_at_end,
            "single": self.single,
        }
        return np.array([float(made[name]) for name in FEATURES])

    def as_dict(self) -> dict[str, float | str]:
        """Plain values, with the probability."""
        return {**asdict(self), "probability": shipped_presence().of(self)}


FEATURES = ("margin", "lost", "slots", "visibility", "shape_at_end", "single")
_TABLE = "presence.toml"


@dataclass(frozen=True)
class Presence:
    """Weights of the features in the log odds that an effect is there."""

    constant: float
    weights: Mapping[str, float]

    def of(self, evidence: Evidence) -> float:
        """Probability that the effect is there."""
        weights = np.array([self.weights[name] for name in FEATURES])
        return float(expit(self.constant + weights @ evidence.features()))


@cache
def shipped_presence() -> Presence:
    """The weights that ship with the program."""
    text = resources.files("gap.decision").joinpath(_TABLE).read_text(encoding="utf-8")
    table = tomllib.loads(text)
    return Presence(table["constant"], table["weights"])


def evidence_of(
    problem: FitProblem, search: SearchResult
) -> tuple[SearchResult, tuple[Evidence, ...]]:
    """The evidence for each effect of the best explanation, and the search with that one first.

    The search compares explanations by chi-square, and it may have stopped in a poor one. Where
    another explanation of as many effects leaves less and has the greater log evidence by `SURER`,
    it takes the place of the best; the one that was becomes a rival. Evidence alone is not enough:
    the discrepancy takes the pattern of some effects, of frictions above all, as its own.
    """
    discrepancy = Discrepancy(problem)
    for _ in range(_EXCHANGES):
        found, others = _weighed(problem, search, discrepancy)
        better = [(h, ahead) for h, ahead in others if h.cost < search.best.cost and ahead >= SURER]
        if not better or len(search.best.keys) < 2:
            break
        search = _exchanged(problem, search, max(better, key=lambda one: one[1])[0])
    return search, found


def _weighed(
    problem: FitProblem, search: SearchResult, discrepancy: Discrepancy
) -> tuple[tuple[Evidence, ...], list[tuple[Hypothesis, float]]]:
    """Evidence for each effect; other explanations of as many, with what their log evidence is
    above that of the best.
    """
    fit, keys = search.best.fit, search.best.keys
    chance = float(np.sqrt(2.0 * len(problem.rows)))
    whole = discrepancy.evidence(fit)
    rivals = [h for h in search.rivals if len(h.keys) == len(keys)][:RIVALS]
    made, all_others = [], []
    for key in keys:
        name = key.partition(":")[0]
        less = refitted_without(problem, fit, key) if len(keys) > 1 else problem.base
        lost = max(less.cost - fit.cost, 0.0)
        others = [h for h in rivals if name not in h.fit.ids]
        if len(keys) > 1:
            others += _stand_ins(problem, search.best, key)
        lead = whole.above(discrepancy.evidence(less))
        leads = [whole.above(discrepancy.evidence(other.fit)) for other in others]
        all_others += [(h, -ahead) for h, ahead in zip(others, leads, strict=True)]
        made.append(
            Evidence(
                name, min(_left_where(problem, less, fit), search.left + chance),
                search.gap + chance, lost,
                max(min([lost, *(h.cost - fit.cost for h in others)]), 0.0),
                lead, min([lead, *leads]), _over_slots(problem, less, fit),
                visibility(problem, less, fit),
                float(any(_against_end(problem, fit, j, search.left + chance)
                          for j, c in enumerate(fit.candidates) if c.key == key)),
                float(len(keys) == 1),
            )
        )  # fmt: skip
    return tuple(made), all_others


def _exchanged(problem: FitProblem, search: SearchResult, better: Hypothesis) -> SearchResult:
    """The outcome of a search with another explanation as the best one."""
    gains = [gain for _, gain in search.steps]
    rivals = [h for h in search.rivals if h is not better and h.fit.ids != better.fit.ids]
    return replace(
        search,
        best=better,
        rivals=sorted([search.best, *rivals], key=lambda h: h.cost),
        left=excess_chi2(problem, better.fit),
        steps=tuple(zip(better.keys, gains, strict=False)),
        per_stroke=None,
    )


def _left_where(problem: FitProblem, less: FitResult, fit: FitResult) -> float:
    """Chi-square beyond the number of rows left by a fit where an effect acts, and one sd of it.

    What is left in another block is no error of the form of the effect, nor could the effect be a
    part of what is not known there. Each block counts by its share of what the fit `less` without
    the effect leaves more.
    """
    before, after = (_white_squares(problem, one.residual) for one in (less, fit))
    count = np.bincount(problem.rows.block, minlength=len(after)).astype(np.float64)
    taken = np.maximum(before - after, 0.0)
    share = taken / max(float(taken.sum()), 1e-300)
    left = float(share @ np.maximum(after - count, 0.0))
    return left + float(np.sqrt(2.0 * max(float(share @ count), 1.0)))


def _white_squares(problem: FitProblem, residual: Array) -> Array:
    """Sum of squares of a residual in units of the noise, by block."""
    white = np.zeros(len(residual))
    for trial, rows in enumerate(problem.noise.trial_rows):
        if len(rows):
            white[rows] = problem.noise.whiten(trial, residual[rows][:, None])[:, 0]
    made = np.bincount(problem.rows.block, weights=white**2, minlength=len(BLOCKS))
    return np.asarray(made, dtype=np.float64)


def _against_end(problem: FitProblem, fit: FitResult, at: int, left: float) -> bool:
    """Whether the data hold a number of a candidate's shape at the end of its range.

    They do where the number inside, by one sd of its prior, costs more than `left`. A number that
    they do not determine may end anywhere: a travel shorter than what is read of it, a knee in
    pressure where the pressure is held.
    """
    candidate = fit.candidates[at]
    for key, (low, high) in candidate.free.items():
        number = candidate.shape[key]
        if 1.02 * low < number < 0.98 * high:
            continue
        inside = number * float(np.exp(LOOSE if number <= 1.02 * low else -LOOSE))
        shape = {**candidate.shape, key: inside}
        moved = [*fit.candidates[:at], replace(candidate, shape=shape), *fit.candidates[at + 1 :]]
        other = problem.polish(problem.fit(moved, fit.amounts.tolist(), fit))
        if other.cost - fit.cost > left:
            return True
    return False


def _stand_ins(problem: FitProblem, best: Hypothesis, key: str) -> list[Hypothesis]:
    """Explanations with other effects in the place of one."""
    taken = without(problem, best.fit, key)
    linear = linear_gains(problem, taken)
    gains = linear.by_key()
    defects = {c.key for c in problem.candidates if c.defect}
    rest = Hypothesis(tuple(k for k in best.keys if k != key), taken)
    name = key.partition(":")[0]
    top = sorted(
        (k for k in gains
         if k not in best.keys and k not in defects and k.partition(":")[0] != name),
        key=lambda k: -gains[k],
    )  # fmt: skip
    made = []
    for other in top[:STAND_INS]:
        fitted = fit_shapes(problem, fit_further(problem, rest, other, linear).fit)
        keys = tuple(other if k == key else k for k in best.keys)
        made.append(Hypothesis(keys, in_order(problem, fitted, keys)))
    return made


def _over_slots(problem: FitProblem, less: FitResult, fit: FitResult) -> float:
    """T-value over slots of the whitened squares that an effect takes."""
    units = problem.units
    rise = np.zeros(int(units.max()) + 1)
    for trial, rows in enumerate(problem.noise.trial_rows):
        if len(rows):
            both = np.stack([less.residual[rows], fit.residual[rows]], axis=1)
            white = problem.noise.whiten(trial, both)
            rise[units[trial]] += float(np.sum(white[:, 0] ** 2) - np.sum(white[:, 1] ** 2))
    if len(rise) < 2:
        return 0.0
    error = float(rise.std(ddof=1) / np.sqrt(len(rise)))
    return float(rise.mean()) / max(error, 1e-9)


def only_effects(problem: FitProblem, search: SearchResult, kept: tuple[str, ...]) -> SearchResult:
    """The outcome of a search with some effects of its best explanation alone, fitted anew."""
    keys = tuple(key for key in search.best.keys if key.partition(":")[0] in kept)
    candidates, amounts = search.best.fit.kept(lambda candidate: candidate.key in keys)
    fit = problem.polish(problem.fit(candidates, amounts, search.best.fit))
    return replace(
        search,
        best=Hypothesis(keys, fit),
        rivals=[],
        left=excess_chi2(problem, fit),
        steps=tuple(step for step in search.steps if step[0] in keys),
        per_stroke=None,
    )
