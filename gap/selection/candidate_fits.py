"""Fits of one more effect: linear gains, then nonlinear fits in its best shapes and forms."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gap.effects.candidates import Candidate
from gap.estimation.config import ESTIMATION
from gap.estimation.fit_problem import FitProblem, FitResult
from gap.estimation.information import projected
from gap.estimation.shape_fit import fit_shapes
from gap.selection.config import SELECTION, SelectionConfig
from gap.selection.inclusion import excess_chi2
from plant.arrays import Array
from plant.constants import KEYS
from plant.effects.arguments import Shape
from plant.effects.catalogue import CATALOGUE
from plant.effects.sensors.length_label import SAME_LABEL_MM

MOUNTINGS = "mountings"
"""The common part of the offsets of all mountings: each offset is chance, their mean is not."""


def _stands_for() -> dict[str, tuple[str, ...]]:
    made: dict[str, tuple[str, ...]] = {}
    for effect in CATALOGUE.values():
        for key, own in effect.keys().items():
            calibration = f"calibration {effect.calibration}" if effect.calibration else ""
            for constant in (own, calibration, *effect.stands_for):
                if constant:
                    made[constant] = (*made.get(constant, ()), key)
    return made


STANDS_FOR = _stands_for()
"""Effects in whose place a constant may have moved."""


@dataclass(frozen=True)
class Hypothesis:
    """One explanation that was fitted: its keys (id, or id:edge) and the fitted state."""

    keys: tuple[str, ...]
    fit: FitResult

    @property
    def cost(self) -> float:
        """Whitened sum of squares left."""
        return self.fit.cost


@dataclass(frozen=True)
class LinearGains:
    """Gain and amount of each candidate alone, linearised at a fit; both shape (candidates,)."""

    candidates: tuple[Candidate, ...]
    gain: Array
    amount: Array

    def by_key(self) -> dict[str, float]:
        """Best gain of the candidates of each key."""
        best: dict[str, float] = {}
        for candidate, gain in zip(self.candidates, self.gain.tolist(), strict=True):
            best[candidate.key] = max(best.get(candidate.key, 0.0), gain)
        return best

    def of_key(self, key: str) -> list[int]:
        """Candidates of a key, best gain first."""
        own = [j for j, candidate in enumerate(self.candidates) if candidate.key == key]
        return sorted(own, key=lambda j: -self.gain[j])

    def start(self, j: int) -> float:
        """Amount from which a fit of candidate `j` starts."""
        candidate, amount = self.candidates[j], float(self.amount[j])
        if candidate.switch:
            return 1.0
        return max(amount, 0.0) if candidate.sign else amount


def linear_gains(problem: FitProblem, fit: FitResult) -> LinearGains:
    """Linear gains of all candidates of a problem at a fit."""
    evidence = problem.evidence(fit)
    p = projected(evidence, evidence.total)
    norm = np.maximum(np.diag(p)[1:], 1e-9)
    amount = p[0, 1:] / norm
    positive = np.array([s.sign > 0 for s in problem.candidates])
    gain = np.where(positive & (amount < 0.0), 0.0, p[0, 1:] ** 2 / norm)
    return LinearGains(problem.candidates, gain, amount)


def is_bent(problem: FitProblem, fit: FitResult, config: SelectionConfig = SELECTION) -> bool:
    """Whether constants stand at the ends of their tolerances and more than chance is left.

    Effects are missing then, or wrong ones are there, and the constants have taken their place. A
    fit also starts from the stated constants; from the bent ones it may not find its way back.
    """
    far = float(np.abs(fit.shift).max(initial=0.0)) > config.freed_from_sd
    return far and excess_chi2(problem, fit) > 2.0 * float(np.sqrt(2.0 * len(problem.rows)))


def fit_further(
    problem: FitProblem,
    before: Hypothesis,
    key: str,
    linear: LinearGains,
    fresh: LinearGains | None = None,
    config: SelectionConfig = SELECTION,
) -> Hypothesis:
    """Fit `key` beside the effects of `before`, in its best shapes.

    Args:
        linear: gains at `before`.
        fresh: gains whose amounts a second fit starts with, from the stated constants.
    """
    fit = before.fit
    at = linear.of_key(key)
    best: FitResult | None = None
    for j in at[: config.fitted_shapes]:
        if best is not None and linear.gain[j] < config.fitted_shape_share * linear.gain[at[0]]:
            continue
        candidates = [*fit.candidates, problem.candidates[j]]
        ends = [] if best is None else [best]
        ends.append(problem.fit(candidates, [*fit.amounts, linear.start(j)], fit))
        exchanged = _exchanged(problem, fit, key, config)
        if exchanged is not None:
            shift, amount = exchanged
            ends.append(problem.fit_from(shift, candidates, [*fit.amounts, amount]))
        if fresh is not None:
            ends.append(problem.fit_afresh(candidates, [*fit.amounts, fresh.start(j)]))
        if fresh is not None and exchanged is not None:
            ends.append(problem.fit_afresh(candidates, [*fit.amounts, exchanged[1]]))
        best = min(ends, key=lambda end: end.cost)
    assert best is not None
    return Hypothesis((*before.keys, key), best)


def _exchanged(
    problem: FitProblem, fit: FitResult, key: str, config: SelectionConfig
) -> tuple[Array, float] | None:
    """Constants with the one in whose place `key` may stand put back, and the equal amount.

    A descent along the valley between the two would take many steps.
    """
    for at, name in enumerate(problem.names):
        shifted = abs(fit.shift[at]) >= config.shifted_constant_sd
        if key not in STANDS_FOR.get(name, ()) or not shifted:
            continue
        c = problem.data.constants
        sd = problem.data.calibration.get(name.removeprefix("calibration "))
        amount = float(fit.shift[at]) * (c.tolerance_si(name) if sd is None else sd)
        effect = CATALOGUE[key.partition(":")[0]]
        if effect.keys()[key] != name:
            if sd is None:
                continue
        elif effect.ratio:
            amount /= max(getattr(c, KEYS[name].field), 1e-300)
        else:
            amount *= 1.0 / KEYS[name].to_si
        shift = fit.shift.copy()
        shift[at] = 0.0
        return shift, amount
    return None


def keys_of_shifted_constants(
    problem: FitProblem, fit: FitResult, beyond: float = ESTIMATION.tolerance_sd
) -> list[str]:
    """Keys of effects in whose place a constant has moved more than `beyond` sd; four at most.

    Beside strong data the sensitivity of an effect must equal that of the constant to the last
    digit to show a linear gain, so these are always fitted.
    """
    known = {candidate.key for candidate in problem.candidates}
    far = [
        (abs(shift), name)
        for name, shift in zip(problem.names, fit.shift.tolist(), strict=True)
        if abs(shift) > beyond and name in STANDS_FOR
    ]
    own = fit.shift[len(problem.names) - problem.unnamed :][: problem.mountings]
    common = abs(float(own.sum())) / np.sqrt(max(len(own), 1))
    if common > beyond:
        far.append((common, MOUNTINGS))
    return [k for _, name in sorted(far, reverse=True) for k in STANDS_FOR[name] if k in known][:4]


def in_best_form(
    problem: FitProblem, before: FitResult, hypothesis: Hypothesis, linear: LinearGains
) -> Hypothesis:
    """The last effect in the form that leaves least once the numbers of its shape are fitted."""
    best = fit_shapes(problem, hypothesis.fit)
    forms = {frozenset(hypothesis.fit.candidates[-1].shape)}
    for j in np.argsort(-linear.gain).tolist():
        candidate = problem.candidates[j]
        form = frozenset(candidate.shape)
        if candidate.key != hypothesis.keys[-1] or form in forms:
            continue
        forms.add(form)
        start = [*before.amounts, linear.start(j)]
        other = fit_shapes(problem, problem.fit([*before.candidates, candidate], start, before))
        best = min(best, other, key=lambda fit: fit.cost)
    return Hypothesis(hypothesis.keys, best)


def rivals_in_best_form(
    problem: FitProblem,
    before: FitResult,
    tried: list[Hypothesis],
    linear: LinearGains,
    config: SelectionConfig = SELECTION,
) -> list[Hypothesis]:
    """Best first; the leading ones in their best form and fitted to the end.

    None leads by a lucky shape then, or follows because its descent stopped early.
    """
    tried = sorted(tried, key=lambda hypothesis: hypothesis.cost)
    near = max(
        near_cost(problem, tried[0].cost, config),
        before.cost - config.near_rival_share * excess_chi2(problem, before),
    )
    leading = [h for h in tried[: config.rivals_in_best_form] if h.cost <= near]
    made = [
        _in_whole_form(problem, in_best_form(problem, before, h, linear), config) for h in leading
    ]
    made = [Hypothesis(h.keys, problem.polish(h.fit)) for h in made]
    return sorted(made + tried[len(leading) :], key=lambda hypothesis: hypothesis.cost)


def _in_whole_form(
    problem: FitProblem, hypothesis: Hypothesis, config: SelectionConfig
) -> Hypothesis:
    """The last effect with all that belongs to its form.

    Of an effect whose size may grow with pressure that is the part that goes with the pressure and
    the part that does not: without one of them it would lose to another effect that has the
    pressure in it. What was before the data is as leaves less. A scale may follow a curve.
    """
    search = hypothesis.fit.candidates[-1].search
    if search.either:
        hypothesis = _either(problem, hypothesis, search.either, config)
    if search.curve is not None:
        return _along_curve(problem, hypothesis, search.curve, config)
    if search.growth is None:
        return hypothesis
    gap = excess_chi2(problem, problem.base)
    linear = linear_gains(problem, hypothesis.fit)
    both = with_second_shape(problem, hypothesis, linear, gap, config)
    return hypothesis if both is None else Hypothesis(both.keys, fit_shapes(problem, both.fit))


def _either(
    problem: FitProblem, hypothesis: Hypothesis, name: str, config: SelectionConfig
) -> Hypothesis:
    """The last effect with the key `name` of its shape at 1, where that leaves less."""
    key, fit = hypothesis.keys[-1], hypothesis.fit
    turned = [
        replace(candidate, shape={**candidate.shape, name: 1.0})
        if candidate.key == key else candidate
        for candidate in fit.candidates
    ]  # fmt: skip
    other = problem.fit_from(fit.shift, turned, list(fit.amounts))
    if other.cost > fit.cost - config.least_gain:
        return hypothesis
    return Hypothesis(hypothesis.keys, fit_shapes(problem, other))


def _along_curve(
    problem: FitProblem,
    hypothesis: Hypothesis,
    curve: Shape,
    config: SelectionConfig,
) -> Hypothesis:
    """The last effect along a curve, where that takes most of what its other forms leave.

    A curve has several numbers more, and so must be needed, and the readings must lie in as many
    parts of the range: through fewer levels a curve goes whatever they show.
    """
    fit = hypothesis.fit
    left = excess_chi2(problem, fit)
    if left < config.curve_of_gap * excess_chi2(problem, problem.base):
        return hypothesis
    key = hypothesis.keys[-1]
    best = _best_along_curve(problem, fit, key, curve)
    if best is None or left - excess_chi2(problem, best) < config.curve_of_left * left:
        return hypothesis
    return Hypothesis(hypothesis.keys, best)


def _best_along_curve(
    problem: FitProblem, fit: FitResult, key: str, curve: Shape
) -> FitResult | None:
    """The fit with the effect of `key` along a curve; None where the data have too few levels."""
    own = next(candidate for candidate in fit.candidates if candidate.key == key)
    if _levels(problem, own) < len(curve) + 1:  # its numbers and the amount
        return None
    total = sum(
        float(amount)
        for candidate, amount in zip(fit.candidates, fit.amounts, strict=True)
        if candidate.key == key
    )
    others, amounts = fit.kept(lambda candidate: candidate.key != key)
    ends = []
    for start in (problem.fit, problem.fit_afresh):
        end = start([*others, replace(own, shape=curve)], [*amounts, total])
        ends.append(fit_shapes(problem, problem.polish(fit_shapes(problem, end))))
        if not excess_chi2(problem, ends[-1]):
            break
    return min(ends, key=lambda end: end.cost)


def curved_instead(problem: FitProblem, before: Hypothesis, further: Hypothesis) -> Hypothesis:
    """The explanation before with one effect along a curve, where that is as good as `further`.

    What the straight form of an effect leaves looks like a further effect; else `before` itself.
    """
    made = [before]
    for candidate in before.fit.candidates:
        curve = candidate.search.curve
        if curve is not None and not candidate.curved:
            found = _best_along_curve(problem, before.fit, candidate.key, curve)
            if found is not None and found.cost <= further.cost:
                made.append(Hypothesis(before.keys, found))
    return min(made, key=lambda hypothesis: hypothesis.cost)


def _levels(problem: FitProblem, candidate: Candidate) -> int:
    """Tenths of a sensor's range in which the data have readings; of labels, their number."""
    on = CATALOGUE[candidate.id].diagnosis
    if on.length is not None:
        grids = problem.grid.points.values()
        written = np.concatenate([points.length[points.held] for points in grids])
        return len(np.unique(np.round(written / (SAME_LABEL_MM * 1e-3))))
    if on.pressure_linearity is not None:
        read = problem.rows.pressure
    else:
        points = problem.grid.points
        read = np.concatenate([points[b].reading for b in candidate.blocks if b in points])
    read = np.abs(read[np.isfinite(read)])
    if not len(read) or read.max() == 0.0:
        return 0
    return len(np.unique(np.minimum(np.floor(10.0 * read / read.max()), 9.0)))


def near_cost(problem: FitProblem, least: float, config: SelectionConfig = SELECTION) -> float:
    """Cost up to which a hypothesis is a near rival of one with cost `least`."""
    rows = len(problem.rows)
    return least + config.near_rival * max(least - rows, float(np.sqrt(2.0 * rows)))


def with_second_shape(
    problem: FitProblem,
    hypothesis: Hypothesis,
    linear: LinearGains,
    gap: float,
    config: SelectionConfig = SELECTION,
) -> Hypothesis | None:
    """The last effect with a second shape, where that takes a visible share of the gap."""
    key, fit = hypothesis.keys[-1], hypothesis.fit
    if sum(candidate.key == key for candidate in fit.candidates) > 1:
        return None
    used = {id(candidate) for candidate in fit.candidates}
    at = [j for j in linear.of_key(key) if id(problem.candidates[j]) not in used]
    if not at or problem.candidates[at[0]].search.one_shape or fit.candidates[-1].curved:
        return None
    left = excess_chi2(problem, fit)
    share = min(config.second_shape_of_gap * gap, config.second_shape_of_left * left)
    if linear.gain[at[0]] < max(config.second_shape_gain, share):
        return None
    # The first step of a form says little of what it leaves once its numbers are fitted.
    forms: dict[frozenset[str], int] = {}
    for j in at:
        forms.setdefault(frozenset(problem.candidates[j].shape), j)
    tried = []
    for j in list(forms.values())[: config.second_shapes]:
        second = problem.candidates[j]
        if second.search.either in fit.candidates[-1].shape:
            either = second.search.either
            shape = {**second.shape, either: fit.candidates[-1].shape[either]}
            second = replace(second, shape=shape)
        start = [*fit.amounts, linear.start(j)]
        tried.append(fit_shapes(problem, problem.fit([*fit.candidates, second], start, fit)))
    fitted = min(tried, key=lambda one: one.cost)
    enough = fitted.cost < hypothesis.cost - config.second_shape_fitted
    return Hypothesis(hypothesis.keys, fitted) if enough else None
