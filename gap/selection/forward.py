"""Which effects explain the gap: forward over effects, forms left free, rivals kept.

An effect enters when it takes away more than chance could and a fair share of the gap; shapes of
the same effect may share its place, so that one effect of another form does not take two. Every
effect that was nearly as good stays on the list of rivals.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from gap.effects.candidates import Suspect
from gap.estimation.agreement import replicate_inflation
from gap.estimation.fit_problem import FitProblem, FitResult
from gap.estimation.information import SLACK
from gap.estimation.non_identical import non_identical
from gap.estimation.null_distribution import held_out_gain, simulated_null
from gap.estimation.shape_fit import fit_shapes
from gap.selection.inclusion import (
    apart,
    excess_chi2,
    inclusion_record,
    passes_inclusion_test,
    same_family,
)
from gap.selection.refine import (
    BENT,
    MOUNTINGS,
    NEAR,
    SHAPED,
    STANDS_FOR,
    Hypothesis,
    flexed_by_second,
    gains_by_key,
    in_best_form,
    linear_gains,
    refine,
    with_free_shapes,
)
from gap.selection.swap import drop_needless, swapped
from plant.effects.catalogue import CATALOGUE

Array = npt.NDArray[np.float64]

ALARM = 28.0
"""Least gain (drop of the whitened sum of squares) of a first effect; see docs/gap.md."""
CHANCE = 0.002
BEYOND_CHANCE = 1.7
"""How far beyond the simulated null a first effect must reach: real noise has other forms too."""
PLAIN = 100.0
"""Gain from which a first effect needs no proof on slots it was not fitted to."""
CARRIED = 0.3
"""Least share of its gain that a first effect must carry over to such slots."""
BETTER = 4.0
"""How much less another effect must leave to take the place of one, in whitened squares."""
MOST = 3
_REFINED = 7
_ELSEWHERE = 4
_DELAYS_MS = (3.0, 8.0, 15.0, 25.0)
_CLOCKS_MS = (8.0, 20.0, 45.0, 80.0, 120.0, 170.0, 230.0, 300.0, 380.0, 480.0)


@dataclass
class SearchResult:
    """What the search found.

    Attributes:
        chosen: the explanation kept; no keys at all when nothing alarmed.
        rivals: other explanations with as many effects, best first.
        first_gain: gain of the best single effect, by key, linearised at the base.
        excess: whitened gap beyond noise at the base.
        left: the same after the explanation.
        alarm: gain that a first effect needed on these data.
        chance: share of simulated data sets without a gap whose best gain is as large.
        steps: (key, gain) of each effect in order of entry.
        tried: for each step beyond the first the best further effect and what spoke for it.
        last_gain: gain of each key on top of the explanation, linearised.
        uneven: the explanation with its valve delays free to differ at each stroke, if it has any.
    """

    best: Hypothesis
    rivals: list[Hypothesis]
    first_gain: dict[str, float]
    excess_chi2: float
    left: float
    alarm: float = ALARM
    chance: float = 1.0
    steps: list[tuple[str, float]] = field(default_factory=list)
    tried: list[dict[str, float | str]] = field(default_factory=list)
    last_gain: dict[str, float] = field(default_factory=dict)
    per_stroke: FitResult | None = None

    @property
    def remaining(self) -> FitResult:
        """The fit whose residual speaks for or against the explanation."""
        return self.per_stroke or self.best.fit


def search_effects(problem: FitProblem) -> SearchResult:
    """Search for up to three effects that explain the gap of `problem`."""
    fit = problem.base
    gains, amounts = linear_gains(problem, fit)
    fresh: Array | None = None
    if np.abs(fit.shift).max(initial=0.0) > BENT:
        # Constants at their limits: the candidates are also asked at the plant as stated.
        fresh_gains, fresh = linear_gains(problem, problem.stated())
        fresh_gains = fresh_gains * max(naming_scale(problem, gains, fresh_gains), 0.0)
        gains = np.maximum(gains, np.minimum(fresh_gains, excess_chi2(problem, fit)))
    for key, (gain, amount) in (_scan_clocks(problem) | _scan_delays(problem)).items():
        for j, candidate in enumerate(problem.candidates):
            if candidate.key == key and gain > gains[j]:
                gains[j], amounts[j] = gain, amount
    null = simulated_null(problem)
    alarm = max(ALARM, BEYOND_CHANCE * null.threshold(CHANCE))
    search = SearchResult(
        Hypothesis((), fit),
        [],
        gains_by_key(problem, gains),
        excess_chi2(problem, fit),
        excess_chi2(problem, fit),
        alarm,
        null.chance(float(gains.max(initial=0.0))),
    )
    keys: tuple[str, ...] = ()
    for step in range(MOST):
        best = gains_by_key(problem, gains)
        top = sorted((k for k in best if k not in keys), key=lambda k: -best[k])
        bent = [key for key in keys_of_shifted_constants(problem, fit) if key not in keys]
        if not top or (best[top[0]] < alarm and not bent):
            break
        gain = best[top[0]]
        if step == 0 and not bent and gain / replicate_inflation(problem, top[0]) < alarm:
            break
        small = step == 0 and gain < PLAIN and not bent
        if small and held_out_gain(problem, top[0])[0] < CARRIED * gain:
            break
        tried = [
            refine(problem, fit, keys, key, gains, amounts, fresh if step == 0 else None)
            for key in dict.fromkeys([*_candidates(problem, fit, top, best), *bent])
        ]
        tried = with_free_shapes(problem, fit, tried, gains, amounts)
        relative = min((c.cost for c in tried if same_family(fit, c.fit)), default=np.inf)
        passed = [
            hypothesis
            for hypothesis in tried
            if _counts(problem, search, fit, hypothesis, relative)
        ]
        if step:
            key, after = (passed or tried)[0].keys[-1], (passed or tried)[0].fit
            search.tried.append(
                inclusion_record(problem, search.excess_chi2, alarm, fit, key, after, bool(passed))
            )
        if not passed:
            break
        tried.remove(passed[0])
        tried.insert(0, passed[0])
        search.steps.append((tried[0].keys[-1], fit.cost - tried[0].cost))
        search.best = tried[0]
        search.rivals = [hypothesis for hypothesis in tried[1:] if not step or hypothesis in passed]
        fit = problem.polish(fit_shapes(problem, problem.polish(tried[0].fit)))
        search.best = Hypothesis(tried[0].keys, fit)
        keys = tried[0].keys
        gains, amounts = linear_gains(problem, fit)
        flexed = flexed_by_second(problem, search.best, gains, amounts, search.excess_chi2)
        if flexed is not None:
            fit = fit_shapes(problem, flexed.fit)
            search.best = Hypothesis(keys, fit)
            gains, amounts = linear_gains(problem, fit)
        one = _one_for_two(problem, search)
        if one is not None:
            search.steps[-2:] = [(one.keys[-1], search.steps[-2][1] + search.steps[-1][1])]
            search.best, search.rivals = one, [c for c in search.rivals if c.keys != one.keys]
        before = search.best
        _set_right(problem, search)
        if one is not None or search.best is not before:
            keys, fit = search.best.keys, search.best.fit
            gains, amounts = linear_gains(problem, fit)
    search.rivals = _polished(problem, search)
    search.left = excess_chi2(problem, fit)
    search.last_gain = gains_by_key(problem, gains)
    return search


def _set_right(problem: FitProblem, search: SearchResult) -> None:
    """Leave out what the last effect made needless, and put better ones in the place of others."""
    if len(search.best.keys) < 2:
        return
    less = drop_needless(problem, search.best, search.alarm)
    if less is not None:
        gone = next(k for k, (key, _) in enumerate(search.steps) if key not in less.keys)
        search.steps[gone : gone + 2] = [
            (search.steps[gone + 1][0], search.steps[gone][1] + search.steps[gone + 1][1])
        ]
        search.best, search.rivals = less, []
    if len(search.best.keys) < 2:
        return
    others = swapped(problem, search.best)
    if others and others[0].cost < search.best.cost - BETTER:
        search.steps = [
            (key, gain) for key, (_, gain) in zip(others[0].keys, search.steps, strict=True)
        ]
        others.append(search.best)
        search.best = others.pop(0)
    known = {hypothesis.fit.ids for hypothesis in search.rivals} | {search.best.fit.ids}
    search.rivals += [hypothesis for hypothesis in others if hypothesis.fit.ids not in known]


def _polished(problem: FitProblem, search: SearchResult) -> list[Hypothesis]:
    """Rivals, those near the explanation fitted to the end as it was: a descent that stopped early
    would look like a worse fit.
    """
    least = search.best.cost
    near = least + NEAR * max(least - len(problem.rows), float(np.sqrt(2.0 * len(problem.rows))))
    made = [
        Hypothesis(hypothesis.keys, problem.polish(hypothesis.fit))
        if at < SHAPED and hypothesis.cost < near
        else hypothesis
        for at, hypothesis in enumerate(
            sorted(search.rivals, key=lambda hypothesis: hypothesis.cost)
        )
    ]
    return sorted(made, key=lambda hypothesis: hypothesis.cost)


def _candidates(
    problem: FitProblem, fit: FitResult, top: list[str], best: dict[str, float]
) -> list[str]:
    """Keys worth a nonlinear fit: the best, and the best that show in other channels.

    What is left of a large effect whose form is not exact outweighs a second effect elsewhere.
    """
    made = [key for key in top[:_REFINED] if best[key] > 0.3 * best[top[0]]]
    elsewhere = [key for key in top if apart(problem, fit, key)] if fit.candidates else []
    made += [
        key for key in elsewhere[:_ELSEWHERE]
        if key not in made and best[key] > 0.3 * best[elsewhere[0]]
    ]  # fmt: skip
    return made


def keys_of_shifted_constants(
    problem: FitProblem, fit: FitResult, beyond: float = SLACK
) -> list[str]:
    """Keys of effects in whose place a constant has left its tolerance, or gone `beyond` (sd).

    Next to strong data a signature must match the constant's to the last digit to show that it
    could take over, so these are always fitted.
    """
    known = {candidate.key for candidate in problem.candidates}
    far = [
        (abs(shift), name)
        for name, shift in zip(problem.names, fit.shift.tolist(), strict=True)
        if abs(shift) > beyond and name in STANDS_FOR
    ]
    # Each mounting's offset is drawn about zero: what all share is a label's or the camera's.
    own = fit.shift[len(problem.names) - problem.unnamed :][: problem.mountings]
    common = abs(float(own.sum())) / np.sqrt(max(len(own), 1))
    if common > beyond:
        far.append((common, MOUNTINGS))
    return [k for _, name in sorted(far, reverse=True) for k in STANDS_FOR[name] if k in known][:4]


def _counts(
    problem: FitProblem,
    search: SearchResult,
    before: FitResult,
    hypothesis: Hypothesis,
    relative: float,
) -> bool:
    """Whether an effect that was fitted takes away enough to count."""
    if not before.candidates:
        return before.cost - hypothesis.cost >= search.alarm
    key = hypothesis.keys[-1]
    return passes_inclusion_test(
        problem, search.excess_chi2, search.alarm, before, key, hypothesis.fit, relative
    )


def _scan_clocks(problem: FitProblem) -> dict[str, tuple[float, float]]:
    """Gain and amount of whole clock offsets, too large for a signature to point at."""
    found: dict[str, tuple[float, float]] = {}
    if excess_chi2(problem, problem.base) < 0.3 * len(problem.rows):
        return found
    for candidate in problem.candidates:
        if candidate.id not in ("force_clock", "pressure_clock", "camera_delay"):
            continue
        best = (0.0, 0.0)
        for start in (problem.base.shift, np.zeros(len(problem.names))):

            def gain(
                amount: float, at: Array = start, of: Suspect = candidate
            ) -> tuple[float, float]:
                return problem.base.cost - problem.cost_at(at, (of,), np.array([amount])), amount

            for size in _CLOCKS_MS:
                best = max(best, gain(size), gain(-size))
            step = 0.2 * abs(best[1])
            while best[0] > 0.0 and step > 1.0:
                best = max(best, gain(best[1] + step), gain(best[1] - step))
                step *= 0.6
        if best[0] > 0.0:
            found[candidate.key] = best
    return found


def _scan_delays(problem: FitProblem) -> dict[str, tuple[float, float]]:
    """Gain and amount of valve delays in tests that a controller made.

    Its pulses may be shorter than the delay, and then do nothing at all: a signature of a
    millisecond does not point at twenty. Commands that are alike in all replicates are long ones.
    """
    found: dict[str, tuple[float, float]] = {}
    if not non_identical(problem.data) or excess_chi2(problem, problem.base) < 0.3 * len(
        problem.rows
    ):
        return found
    for candidate in problem.candidates:
        if candidate.id != "valve_delay":
            continue
        tried = [
            (
                problem.base.cost
                - problem.cost_at(problem.base.shift, (candidate,), np.array([size])),
                size,
            )
            for size in _DELAYS_MS
        ]
        found[candidate.key] = max(tried)
    return {key: best for key, best in found.items() if best[0] > 0.0}


def naming_scale(problem: FitProblem, gains: Array, fresh: Array) -> float:
    """Factor that brings gains at the stated plant to those at the recalibrated one."""
    return float(gains.max(initial=0.0) / max(fresh.max(initial=0.0), 1e-9))


def _one_for_two(problem: FitProblem, search: SearchResult) -> Hypothesis | None:
    """The last effect alone where it does without the one before it, of its own family.

    An effect in a form of its own may be begun by a relative, and only then be seen itself.
    """
    keys = search.best.keys
    if len(keys) < 2 or _family(keys[-1]) != _family(keys[-2]) or keys[-1] == keys[-2]:
        return None
    fit = search.best.fit
    others = [(s, a) for s, a in zip(fit.candidates, fit.amounts, strict=True)
              if s.key not in keys[-2:]]  # fmt: skip
    below = (
        problem.base
        if not others
        else problem.fit([s for s, _ in others], [float(a) for _, a in others])
    )
    gains, amounts = linear_gains(problem, below)
    alone = refine(problem, below, keys[:-2], keys[-1], gains, amounts)
    alone = in_best_form(problem, below, alone, gains, amounts)
    gains, amounts = linear_gains(problem, alone.fit)
    flexed = flexed_by_second(problem, alone, gains, amounts, search.excess_chi2)
    if flexed is not None:
        alone = Hypothesis(alone.keys, problem.polish(fit_shapes(problem, flexed.fit)))
    needed = passes_inclusion_test(
        problem, search.excess_chi2, search.alarm, alone.fit, keys[-2], fit
    )
    return None if needed else alone


def _family(key: str) -> str:
    name = key.partition(":")[0]
    return CATALOGUE[name].family if name in CATALOGUE else name


def why_not(problem: FitProblem, search: SearchResult, named: set[str]) -> dict[str, str]:
    """For each entry not in the set: what share of the gap it closes alone."""
    made: dict[str, str] = {}
    rivals = {c.fit.ids[-1]: c for c in reversed(search.rivals)}
    for candidate in problem.candidates:
        name = candidate.id
        if candidate.defect or name in named or name in made:
            continue
        gain = max(
            (g for k, g in search.first_gain.items() if k.split(":")[0] == name), default=0.0
        )
        if not any(block in problem.grid.points for block in candidate.blocks):
            made[name] = "no channel in these data would show it"
        elif name in rivals and search.best.keys:
            worse = rivals[name].cost - search.best.cost
            made[name] = f"fits worse than the set by {worse:.0f} in chi-square"
        elif search.excess_chi2 > 1.0:
            made[name] = f"closes {100 * min(gain / search.excess_chi2, 1.0):.0f} % of the gap"
        else:
            made[name] = f"chi-square falls by {gain:.0f} only"
    return made
