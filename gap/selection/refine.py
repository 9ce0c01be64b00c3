"""Fits of one more effect: in its best form, from the places where a descent may begin.

The search (`gap.selection.forward`) decides what counts; here an effect is given its best chance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gap.data.dataset import CALIBRATION
from gap.effects.candidates import Suspect
from gap.estimation.fit_problem import Inquiry, State
from gap.estimation.information import projected
from gap.estimation.shape_fit import shaped
from gap.selection.inclusion import excess
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
class Choice:
    """One explanation that was fitted: its keys (id, or id:edge) and the fitted state."""

    keys: tuple[str, ...]
    state: State

    @property
    def cost(self) -> float:
        """Whitened sum of squares left."""
        return self.state.cost


def linear_gains(q: Inquiry, state: State) -> tuple[Array, Array]:
    """Gain and amount of each suspect alone, linearised at `state`; both shape (suspects,)."""
    evidence = q.evidence(state)
    p = projected(evidence, evidence.total)
    norm = np.maximum(np.diag(p)[1:], 1e-9)
    amounts = p[0, 1:] / norm
    gains = p[0, 1:] ** 2 / norm
    low = np.array([s.sign > 0 for s in q.suspects])
    gains = np.where(low & (amounts < 0.0), 0.0, gains)
    return gains, amounts


def gains_by_key(q: Inquiry, gains: Array) -> dict[str, float]:
    """Best gain of each key's suspects; `gains` has shape (suspects,)."""
    best: dict[str, float] = {}
    for suspect, gain in zip(q.suspects, gains.tolist(), strict=True):
        best[suspect.key] = max(best.get(suspect.key, 0.0), gain)
    return best


def refine(
    q: Inquiry,
    state: State,
    keys: tuple[str, ...],
    key: str,
    gains: Array,
    amounts: Array,
    fresh: Array | None = None,
) -> Choice:
    """Fit `key` on top of `state` in its best shapes; the best fit wins."""
    at = [j for j, suspect in enumerate(q.suspects) if suspect.key == key]
    at.sort(key=lambda j: -gains[j])
    best: State | None = None
    for j in at[:_SHAPES]:
        if best is not None and gains[j] < 0.7 * gains[at[0]]:
            continue
        suspects = [*state.suspects, q.suspects[j]]
        start = [*state.amounts, _start(q.suspects[j], amounts[j])]
        ends = [q.fit(suspects, start, state)]
        swapped = _swapped(q, state, key)
        if swapped is not None:
            ends.append(q.fit_from(swapped[0], suspects, [*state.amounts, swapped[1]]))
        if fresh is not None:
            ends.append(q.fit_afresh(suspects, [*state.amounts, _start(q.suspects[j], fresh[j])]))
        fitted = min(ends, key=lambda end: end.cost)
        if best is None or fitted.cost < best.cost:
            best = fitted
    assert best is not None
    return Choice((*keys, key), best)


def _start(suspect: Suspect, amount: float) -> float:
    if suspect.id == "transport_delay":
        return 1.0
    return max(amount, 0.0) if suspect.sign else amount


def _swapped(q: Inquiry, state: State, key: str) -> tuple[Array, float] | None:
    """Constants with the one that `key` may stand for put back, and the amount that does the same.

    Along the valley between the two a descent would creep.
    """
    for at, name in enumerate(q.names):
        if key not in STANDS_FOR.get(name, ()) or abs(state.shift[at]) < BENT:
            continue
        c = q.data.constants
        sd = q.data.calibration.get(name.removeprefix("calibration "))
        amount = float(state.shift[at]) * (c.tolerance_si(name) if sd is None else sd)
        if key.startswith("flow_area"):
            amount /= max(getattr(c, KEYS[name].field), 1e-300)
        elif key.partition(":")[0] in _PER_SI:
            amount *= _PER_SI[key.partition(":")[0]]
        elif sd is None:
            continue
        shift = state.shift.copy()
        shift[at] = 0.0
        return shift, amount
    return None


def with_free_shapes(
    q: Inquiry, before: State, tried: list[Choice], gains: Array, amounts: Array
) -> list[Choice]:
    """Best first, the leading ones with shapes fitted: none shall lead by its number's luck."""
    tried = sorted(tried, key=lambda choice: choice.cost)
    chance = float(np.sqrt(2.0 * len(q.rows)))
    near = tried[0].cost + NEAR * max(tried[0].cost - len(q.rows), chance)
    near = max(near, before.cost - HALF * excess(q, before))
    made = [
        in_best_form(q, before, choice, gains, amounts) if at < SHAPED and choice.cost <= near
        else choice
        for at, choice in enumerate(tried)
    ]  # fmt: skip
    return sorted(made, key=lambda choice: choice.cost)


def in_best_form(q: Inquiry, before: State, choice: Choice, gains: Array, amounts: Array) -> Choice:
    """The last effect in the form that leaves least once its numbers are fitted."""
    best = shaped(q, choice.state)
    last = choice.state.suspects[-1]
    asked = {frozenset(last.shape)}
    for j in np.argsort(-gains).tolist():
        suspect = q.suspects[j]
        form = frozenset(suspect.shape)
        if suspect.key != choice.keys[-1] or form in asked:
            continue
        asked.add(form)
        start = [*before.amounts, _start(suspect, amounts[j])]
        other = shaped(q, q.fit([*before.suspects, suspect], start, before))
        best = min(best, other, key=lambda state: state.cost)
    return Choice(choice.keys, best)


def flexed_by_second(
    q: Inquiry, choice: Choice, gains: Array, amounts: Array, gap: float
) -> Choice | None:
    """Let the last effect use a second shape where that takes a visible share of the gap."""
    key = choice.keys[-1]
    if key in _ONE_SHAPE:
        return None
    used = {id(suspect) for suspect in choice.state.suspects}
    at = [j for j, s in enumerate(q.suspects) if s.key == key and id(s) not in used]
    if not at:
        return None
    j = max(at, key=lambda k: gains[k])
    if gains[j] < max(20.0, min(0.01 * gap, 0.03 * excess(q, choice.state))):
        return None
    fitted = q.fit(
        [*choice.state.suspects, q.suspects[j]],
        [*choice.state.amounts, _start(q.suspects[j], amounts[j])],
        choice.state,
    )
    return Choice(choice.keys, fitted) if fitted.cost < choice.cost - 15.0 else None
