"""Headline parameters of fitted effects with intervals, and the smallest that would be seen."""

from __future__ import annotations

import numpy as np

from gap.belief import learnt
from gap.evidence import projected
from gap.inquiry import Inquiry, State
from gap.verdict import Estimate
from plant.catalogue import CATALOGUE

_Z95 = 1.96
_FORM = 0.1


def headline_estimates(q: Inquiry, state: State) -> dict[str, Estimate]:
    """Headline parameters of all effects in force, keyed by parameter name.

    Shapes of one effect add up. With two effects of the same parameter name the later gets its
    id in front.
    """
    made: dict[str, Estimate] = {}
    n = len(q.names)
    spread = max(1.0, np.sqrt(state.cost / max(len(q.rows), 1)))
    for name in state.ids:
        entry = CATALOGUE[name]
        at = [j for j, suspect in enumerate(state.suspects) if suspect.id == name]
        if entry.headline is None:
            continue
        amount = float(state.amounts[at].sum())
        index = [n + j for j in at]
        sd = float(np.sqrt(max(state.cover[np.ix_(index, index)].sum(), 0.0))) * spread
        # The headline has a form behind it that is never exact.
        sd = float(np.hypot(sd, learnt().form.get(name, _FORM) * amount))
        if name == "supply_droop":
            active = q.found(state.shift, state.suspects, state.amounts)
            q.model.residual(q.constants(state.shift), active, ["pressure"])
            fall = q.model.fall_pa * 1e-3
            sd = sd * fall / max(abs(amount), 1e-9)
            amount = fall
        low, high = amount - _Z95 * sd, amount + _Z95 * sd
        shift = _offset(q, name)
        key = entry.headline if entry.headline not in made else f"{name}_{entry.headline}"
        made[key] = Estimate(amount + shift, low + shift, high + shift)
        option = state.suspects[at[0]].option
        if option:
            word = "side" if name == "flow_area" else "edge"
            made[word if word not in made else f"{name}_{word}"] = Estimate(option)
    return made


def _offset(q: Inquiry, name: str) -> float:
    """What the headline is at zero effect: ratios and exponents are stated from 1 up."""
    if name in ("flow_area", "polytropic"):
        return 1.0
    if name == "critical_ratio":
        return float(q.data.constants.critical_ratio)
    return 0.0


def limits_of(q: Inquiry, alarm: float) -> dict[str, float]:
    """Smallest headline parameter of each effect that these data would have shown."""
    evidence = q.evidence(q.base)
    p = projected(evidence, evidence.total)
    made: dict[str, float] = {}
    for j, suspect in enumerate(q.suspects):
        if suspect.defect or CATALOGUE[suspect.id].headline is None:
            continue
        strength = float(p[1 + j, 1 + j])
        if strength <= 1e-12:
            continue
        least = float(np.sqrt(alarm / strength))
        made[suspect.id] = min(made.get(suspect.id, np.inf), least)
    return made
