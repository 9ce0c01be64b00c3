"""The improved plant as a TOML file: what `pamrig gap shrink --out` writes."""

from __future__ import annotations

import numpy as np

from gap.estimation.fit_problem import Inquiry, State
from gap.estimation.intervals import headline_estimates, settled
from plant.constants import CHOICES, KEYS, nominal
from plant.effects.catalogue import CATALOGUE


def improved_plant(q: Inquiry, state: State) -> str:
    """The improved plant as TOML: recalibrated and stated constants, and a table for each effect.

    The simulator (`pamrig simulate --plant`), the live prediction (`--predict`), the virtual bench
    and `bench.toml` read it.
    """
    state = settled(q, state)
    lines = ["# The plant as recalibrated on these data, with the effects that explain the gap."]
    constants = q.constants(state.shift)
    usual = nominal()
    lines += [
        f"{name} = {constants.value(name):.8g}"
        for name in KEYS
        if name in q.names or constants.value(name) != usual.value(name)
    ]
    lines += [
        f'{name} = "{getattr(constants, name)}"'
        for name in CHOICES
        if getattr(constants, name) != getattr(usual, name)
    ]
    for name in [*q.data.effects.values, *state.ids]:
        if name not in CATALOGUE:
            continue
        lines += ["", f"[effects.{name}]"]
        entry = CATALOGUE[name]
        if name not in state.ids:
            lines += [f"{k} = {_toml(v)}" for k, v in q.data.effects.values[name].items()]
            continue
        known = {parameter.name: parameter for parameter in entry.parameters}
        for key, estimate in headline_estimates(q, only(state, name), whole=False).items():
            value = estimate.value
            if isinstance(value, str):
                lines.append(f'{key} = "{value}"')
            elif key in known:
                value = min(max(value, known[key].low), known[key].high)
                lines.append(f"{key} = {value:.6g}")
        for key, value in _shape(q, state, name).items():
            value = min(max(value, known[key].low), known[key].high)
            lines.append(f"{key} = {value:.4g}")
    return "\n".join(lines) + "\n"


_SAME_NUMBER = {
    "liner_threshold": {"width_kpa": "width_kpa"},
    "contraction_limit": {"decay_mm": "scale_mm"},
    "braid_friction": {"kpa": "travel_kpa", "mm": "travel_mm"},
    "viscosity": {"power": "exponent", "pressure": "pressure_share"},
    "link_friction": {"travel_mm": "travel_mm"},
}
"""Numbers of a fitted shape that the plant's own form of the effect has too."""


def _shape(q: Inquiry, state: State, name: str) -> dict[str, float]:
    """Shape parameters of the plant's form of an effect, where its fitted shape says them."""
    own = [(abs(a), s) for s, a in zip(state.suspects, state.amounts, strict=True) if s.id == name]
    shape = max(own, key=lambda one: one[0])[1].shape
    known = _SAME_NUMBER.get(name, {})
    made = {known[key]: value for key, value in shape.items() if key in known}
    if name == "bladder_elasticity":
        made["rest_mm"] = shape["rest"] * q.constants(state.shift).braid_length_m * 1e3
    return made


def _toml(value: object) -> str:
    return f'"{value}"' if isinstance(value, str) else repr(value)


def only(state: State, name: str) -> State:
    """The state with the suspects of one effect, for its parameters."""
    at = [j for j, suspect in enumerate(state.suspects) if suspect.id == name]
    n = len(state.shift)
    index = [*range(n), *(n + j for j in at)]
    return State(
        state.shift, tuple(state.suspects[j] for j in at), state.amounts[at], state.residual,
        state.cost, state.cover[np.ix_(index, index)],
    )  # fmt: skip
