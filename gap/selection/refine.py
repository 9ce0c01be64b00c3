"""Fits of one more effect: in its best form, from the places where a descent may begin.

The search (`gap.selection.forward`) decides what counts; here an effect is given its best chance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gap.data.dataset import CALIBRATION
from gap.effects.candidates import Suspect
from gap.estimation.fit_problem import FitProblem, FitResult
from gap.estimation.information import projected
from gap.estimation.shape_fit import fit_shapes
from gap.selection.inclusion import excess_chi2
from plant.constants import KEYS
from plant.effects.catalogue import CATALOGUE

Array = npt.NDArray[np.float64]


EDGES = ("inlet_on", "inlet_off", "outlet_on", "outlet_off")


BENT = 2.2
"""Shift of a constant, in sd, from which an effect may have bent the recalibration."""


SHAPED = 3


NEAR = 4.0
"""Shapes are fitted for the best few that leave less than so many times more than the best, or
than chance,"""


HALF = 0.5
"""or that take away so much of the gap: the rest may be their form."""


_SHAPES = 2


MOUNTINGS = "mountings"
"""What the offsets of all mountings have in common: each is chance, together they are none."""


STANDS_FOR = {
    "supply_kpa": ("supply_droop", "pressure_gain"),
    "gas_temperature_k": ("polytropic",),
    "inlet_conductance_m3_s_pa": ("flow_area:inlet",),
    "outlet_conductance_m3_s_pa": ("flow_area:outlet",),
    "critical_ratio": ("critical_ratio",),
    "dead_volume_ml": ("dead_volume",),
    MOUNTINGS: ("length_label", "camera_scale"),
    **{f"calibration {key}": (name,) for key, name in CALIBRATION.items() if name in CATALOGUE},
    **{f"{e}_ms": (f"valve_delay:{e}",) for e in EDGES},
    **{f"{e}_ms_per_kpa": (f"valve_delay_pressure:{e}",) for e in EDGES},
}
"""Effects that a constant may have moved for."""


_PER_SI = {
    "critical_ratio": 1.0, "dead_volume": 1e6, "valve_delay": 1e3, "valve_delay_pressure": 1e6,
}  # fmt: skip


_ONE_SHAPE = ("polytropic", "supply_droop")
"""Effects whose shapes are states of the gas: two at once mean nothing."""


@dataclass(frozen=True)
class Hypothesis:
    """One explanation that was fitted: its keys (id, or id:edge) and the fitted state."""

    keys: tuple[str, ...]
    fit: FitResult

    @property
    def cost(self) -> float:
        """Whitened sum of squares left."""
        return self.fit.cost


def linear_gains(problem: FitProblem, fit: FitResult) -> tuple[Array, Array]:
    """Gain and amount of each candidate alone, linearised at `fit`; both shape (candidates,)."""
    evidence = problem.evidence(fit)
    p = projected(evidence, evidence.total)
    norm = np.maximum(np.diag(p)[1:], 1e-9)
    amounts = p[0, 1:] / norm
    gains = p[0, 1:] ** 2 / norm
    low = np.array([s.sign > 0 for s in problem.candidates])
    gains = np.where(low & (amounts < 0.0), 0.0, gains)
    return gains, amounts


def gains_by_key(problem: FitProblem, gains: Array) -> dict[str, float]:
    """Best gain of each key's candidates; `gains` has shape (candidates,)."""
    best: dict[str, float] = {}
    for candidate, gain in zip(problem.candidates, gains.tolist(), strict=True):
        best[candidate.key] = max(best.get(candidate.key, 0.0), gain)
    return best


def refine(
    problem: FitProblem,
    fit: FitResult,
    keys: tuple[str, ...],
    key: str,
    gains: Array,
    amounts: Array,
    fresh: Array | None = None,
) -> Hypothesis:
    """Fit `key` on top of `fit` in its best shapes; the best fit wins."""
    at = [j for j, candidate in enumerate(problem.candidates) if candidate.key == key]
    at.sort(key=lambda j: -gains[j])
    best: FitResult | None = None
    for j in at[:_SHAPES]:
        if best is not None and gains[j] < 0.7 * gains[at[0]]:
            continue
        candidates = [*fit.candidates, problem.candidates[j]]
        start = [*fit.amounts, _start(problem.candidates[j], amounts[j])]
        ends = [problem.fit(candidates, start, fit)]
        swapped = _swapped(problem, fit, key)
        if swapped is not None:
            ends.append(problem.fit_from(swapped[0], candidates, [*fit.amounts, swapped[1]]))
        if fresh is not None:
            ends.append(
                problem.fit_afresh(
                    candidates, [*fit.amounts, _start(problem.candidates[j], fresh[j])]
                )
            )
        fitted = min(ends, key=lambda end: end.cost)
        if best is None or fitted.cost < best.cost:
            best = fitted
    assert best is not None
    return Hypothesis((*keys, key), best)


def _start(candidate: Suspect, amount: float) -> float:
    if candidate.id == "transport_delay":
        return 1.0
    return max(amount, 0.0) if candidate.sign else amount


def _swapped(problem: FitProblem, fit: FitResult, key: str) -> tuple[Array, float] | None:
    """Constants with the one that `key` may stand for put back, and the amount that does the same.

    Along the valley between the two a descent would creep.
    """
    for at, name in enumerate(problem.names):
        if key not in STANDS_FOR.get(name, ()) or abs(fit.shift[at]) < BENT:
            continue
        c = problem.data.constants
        sd = problem.data.calibration.get(name.removeprefix("calibration "))
        amount = float(fit.shift[at]) * (c.tolerance_si(name) if sd is None else sd)
        if key.startswith("flow_area"):
            amount /= max(getattr(c, KEYS[name].field), 1e-300)
        elif key.partition(":")[0] in _PER_SI:
            amount *= _PER_SI[key.partition(":")[0]]
        elif sd is None:
            continue
        shift = fit.shift.copy()
        shift[at] = 0.0
        return shift, amount
    return None


def with_free_shapes(
    problem: FitProblem, before: FitResult, tried: list[Hypothesis], gains: Array, amounts: Array
) -> list[Hypothesis]:
    """Best first, the leading ones with shapes fitted: none shall lead by its number's luck."""
    tried = sorted(tried, key=lambda hypothesis: hypothesis.cost)
    chance = float(np.sqrt(2.0 * len(problem.rows)))
    near = tried[0].cost + NEAR * max(tried[0].cost - len(problem.rows), chance)
    near = max(near, before.cost - HALF * excess_chi2(problem, before))
    made = [
        in_best_form(problem, before, hypothesis, gains, amounts)
        if at < SHAPED and hypothesis.cost <= near
        else hypothesis
        for at, hypothesis in enumerate(tried)
    ]
    return sorted(made, key=lambda hypothesis: hypothesis.cost)


def in_best_form(
    problem: FitProblem, before: FitResult, hypothesis: Hypothesis, gains: Array, amounts: Array
) -> Hypothesis:
    """The last effect in the form that leaves least once its numbers are fitted."""
    best = fit_shapes(problem, hypothesis.fit)
    last = hypothesis.fit.candidates[-1]
    asked = {frozenset(last.shape)}
    for j in np.argsort(-gains).tolist():
        candidate = problem.candidates[j]
        form = frozenset(candidate.shape)
        if candidate.key != hypothesis.keys[-1] or form in asked:
            continue
        asked.add(form)
        start = [*before.amounts, _start(candidate, amounts[j])]
        other = fit_shapes(problem, problem.fit([*before.candidates, candidate], start, before))
        best = min(best, other, key=lambda fit: fit.cost)
    return Hypothesis(hypothesis.keys, best)


def flexed_by_second(
    problem: FitProblem, hypothesis: Hypothesis, gains: Array, amounts: Array, gap: float
) -> Hypothesis | None:
    """Let the last effect use a second shape where that takes a visible share of the gap."""
    key = hypothesis.keys[-1]
    if key in _ONE_SHAPE:
        return None
    used = {id(candidate) for candidate in hypothesis.fit.candidates}
    at = [j for j, s in enumerate(problem.candidates) if s.key == key and id(s) not in used]
    if not at:
        return None
    j = max(at, key=lambda k: gains[k])
    if gains[j] < max(20.0, min(0.01 * gap, 0.03 * excess_chi2(problem, hypothesis.fit))):
        return None
    fitted = problem.fit(
        [*hypothesis.fit.candidates, problem.candidates[j]],
        [*hypothesis.fit.amounts, _start(problem.candidates[j], amounts[j])],
        hypothesis.fit,
    )
    return Hypothesis(hypothesis.keys, fitted) if fitted.cost < hypothesis.cost - 15.0 else None
