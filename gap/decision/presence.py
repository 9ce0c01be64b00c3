"""Presence: the probability of each effect of an explanation, whatever else acts beside it.

An explanation of many effects may be right in most of them and leave a rest that nobody has a name
for. So each effect is asked for by itself: how much worse is the best explanation without it, and
the best with another effect in its place? Both are measured by what the explanation leaves: no form
is exact, and what is left is the size of the model's own error. With such an error the likelihood
falls as a power of what an explanation leaves, so the odds of an effect are a product of powers,
and their logarithm is a sum. Two more features are no likelihoods: how steady the amount is over
slots, and how probable it is that the whole stands for something outside the catalogue. The weights
(`presence.toml`) were learnt (`python -m gap.check.presence`) from sets of one to five effects and
from sets whose effect is not in the catalogue.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from importlib import resources

import numpy as np
from scipy.special import expit

from gap.estimation.cross_validation import left_out
from gap.estimation.fit_problem import FitProblem, FitResult
from gap.estimation.shape_fit import LOOSE, fit_shapes
from gap.selection.candidate_fits import Hypothesis, fit_further, linear_gains
from gap.selection.config import SELECTION
from gap.selection.inclusion import excess_chi2, visibility
from gap.selection.search import SearchResult
from plant.arrays import Array
from plant.effects.catalogue import CATALOGUE

TOLD_APART = 0.03
"""Share of what the explanation leaves that the best other effect must leave beyond it. With less
the two fit alike, and neither is there with more than 1/2. Set on: sets 500 to 521, 600 to 627 and
100 to 138 of the stream `several`: of six such effects above 0.8 five were not there."""
STAND_INS = 2
"""Effects that are fitted in the place of one, best linear gain first."""


@dataclass(frozen=True)
class Evidence:
    """What speaks for one effect of an explanation.

    Attributes:
        id: the effect.
        left: chi-square beyond the number of rows that the explanation leaves, and one sd of it.
        gap: the same of the recalibrated plant.
        lost: rise of chi-square without the effect, all others fitted anew.
        margin: rise of chi-square with the best other effect in its place; `lost` where none.
        slots: t-value over slots of the rise without it.
        visibility: what it takes from some block, in units of its floor.
        shape_at_end: whether the data hold a number of its shape at an end of its range.
        single: whether the explanation has no other effect.
        steady: its amount over the jackknife error over slots of that amount.
        unknown: probability that the explanation, as a whole, stands for an effect outside the
            catalogue (`gap.decision.reliability`).
    """

    id: str
    left: float
    gap: float
    lost: float
    margin: float
    slots: float
    visibility: float
    shape_at_end: float
    single: float
    steady: float
    unknown: float

    def features(self) -> Array:
        """Bounded numbers of order one, in the order of `FEATURES`."""
        made = {
            "margin": np.clip(np.log10(self.margin / self.left + 0.01), -2.0, 1.5),
            "lost": np.clip(np.log10(self.lost / self.left + 0.1), -1.0, 2.0),
            "slots": np.clip(self.slots, 0.0, 4.0),
            "visibility": np.clip(np.log10(self.visibility + 0.05), -1.3, 1.0),
            "shape_at_end": self.shape_at_end,
            "single": self.single,
            "steady": np.clip(np.log10(self.steady + 0.1), -1.0, 2.0),
            "unknown": self.unknown,
        }
        return np.array([float(made[name]) for name in FEATURES])

    def as_dict(self) -> dict[str, float | str]:
        """Plain values, with the probability."""
        return {**asdict(self), "probability": shipped_presence().of(self)}


FEATURES = (
    "margin", "lost", "slots", "visibility", "shape_at_end", "single", "steady", "unknown",
)  # fmt: skip
_TABLE = "presence.toml"


@dataclass(frozen=True)
class Presence:
    """Weights of the features in the log odds that an effect is there."""

    constant: float
    weights: Mapping[str, float]

    def of(self, evidence: Evidence) -> float:
        """Probability that the effect is there: at most 1/2 where another one fits as well."""
        weights = np.array([self.weights[name] for name in FEATURES])
        odds = float(expit(self.constant + weights @ evidence.features()))
        alike = evidence.margin < TOLD_APART * evidence.left
        return min(odds, 0.5) if alike else odds


@cache
def shipped_presence() -> Presence:
    """The weights that ship with the program."""
    text = resources.files("gap.decision").joinpath(_TABLE).read_text(encoding="utf-8")
    table = tomllib.loads(text)
    return Presence(table["constant"], table["weights"])


MAY_CORRECT = 0.75
"""Most probability of an effect that another one shows as, and that is not plainly visible: named
only beside two that are sure. Set on: campaigns 52000 to 52729 of the held-out forms, where a
conductance was named beside a volume or a gas five times, was never there, and took up to 1.2
floors."""


def odds_of(evidence: Sequence[Evidence]) -> dict[str, float]:
    """Probability of each effect of an explanation, by id."""
    shown = {other for one in evidence for other in CATALOGUE[one.id].shows_as}
    made = {}
    for one in evidence:
        probability = shipped_presence().of(one)
        corrects = one.id in shown and one.visibility < SELECTION.plain_visibility
        made[one.id] = min(probability, MAY_CORRECT) if corrects else probability
    return made


def evidence_of(problem: FitProblem, search: SearchResult, unknown: float) -> tuple[Evidence, ...]:
    """The evidence for each effect of the best explanation of a search.

    An effect at two edges (a valve that opens and closes late) is one effect.

    Args:
        unknown: probability that the explanation stands for an effect outside the catalogue.
    """
    fit = search.best.fit
    chance = float(np.sqrt(2.0 * len(problem.rows)))
    steady = _steadiness(problem, fit)
    several = len(fit.ids) > 1
    made = []
    for name in fit.ids:
        less = _without_effect(problem, fit, name) if several else problem.base
        lost = max(less.cost - fit.cost, 0.0)
        others = [h.cost - fit.cost for h in search.rivals if name not in h.fit.ids]
        if several:
            others += _stand_ins(problem, search.best, name)
        made.append(
            Evidence(
                name, search.left + chance, search.gap + chance, lost,
                max(min([lost, *others]), 0.0), _over_slots(problem, less, fit),
                visibility(problem, less, fit),
                float(any(_against_end(problem, fit, j, search.left + chance)
                          for j, c in enumerate(fit.candidates) if c.id == name)),
                float(not several), steady[name], unknown,
            )
        )  # fmt: skip
    return tuple(made)


def _without_effect(problem: FitProblem, fit: FitResult, name: str) -> FitResult:
    """The fit without an effect, all its edges taken out, and all others fitted anew."""
    candidates, amounts = fit.kept(lambda candidate: candidate.id != name)
    return problem.polish(problem.fit(candidates, amounts, fit))


def _steadiness(problem: FitProblem, fit: FitResult) -> dict[str, float]:
    """Amount of each effect over the jackknife error over slots of that amount, by id.

    Some slots need a stand-in, and others do not. Of an effect at two edges, the steadier one:
    their amounts need not have one sign.
    """
    change = left_out(problem, fit, problem.units).change[:, len(problem.names) :]
    slots = len(change)
    made: dict[str, float] = {}
    for key in dict.fromkeys(candidate.key for candidate in fit.candidates):
        own = [j for j, candidate in enumerate(fit.candidates) if candidate.key == key]
        moved = change[:, own].sum(axis=1)
        spread = float(np.sum((moved - moved.mean()) ** 2))
        error = float(np.sqrt((slots - 1) / slots * spread))
        name = fit.candidates[own[0]].id
        one = min(abs(float(fit.amounts[own].sum())) / max(error, 1e-300), _STEADIEST)
        made[name] = max(made.get(name, 0.0), one)
    return made


_STEADIEST = 1e6
"""Stands for an amount that no slot moves."""


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


def _stand_ins(problem: FitProblem, best: Hypothesis, name: str) -> list[float]:
    """Rise of chi-square with other effects in the place of one, all its edges taken out."""
    candidates, amounts = best.fit.kept(lambda candidate: candidate.id != name)
    taken = problem.at(best.fit.shift, candidates, np.array(amounts), best.fit)
    linear = linear_gains(problem, taken)
    gains = linear.by_key()
    defects = {c.key for c in problem.candidates if c.defect}
    rest = Hypothesis(tuple(k for k in best.keys if k.partition(":")[0] != name), taken)
    top = sorted(
        (k for k in gains
         if k not in best.keys and k not in defects and k.partition(":")[0] != name),
        key=lambda k: -gains[k],
    )  # fmt: skip
    made = []
    for other in top[:STAND_INS]:
        fitted = problem.polish(fit_shapes(problem, fit_further(problem, rest, other, linear).fit))
        made.append(fitted.cost - best.fit.cost)
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
