"""Which inputs a hidden effect's gap depends on, and whether an empirical term found them.

Written down from the effects' equations before any term was scored. `needed` holds sets of which
each must be met by one input at least; `allowed` are inputs by which the same gap may show as well:
a constant that was recalibrated with the effect in the data leaves its own pattern, and in a test
in which one input follows another the two are one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

SMALL = 0.1
"""Share from which on an input that has nothing to do with the effect counts as wrong."""


@dataclass(frozen=True)
class Dependence:
    """Inputs of one effect's gap; in its own channel `same_in` it is the same everywhere."""

    needed: tuple[frozenset[str], ...]
    allowed: frozenset[str] = frozenset()
    same_in: str = ""


def _of(*needed: str, allowed: str = "", same_in: str = "") -> Dependence:
    """Each of `needed` is a list of inputs with a bar between, of which one must be there."""
    return Dependence(
        tuple(frozenset(one.split("|")) for one in needed),
        frozenset(filter(None, allowed.split("|"))),
        same_in,
    )


_FLOW = "history|pressure rate"
TRUE_INPUTS: Mapping[str, Dependence] = {
    "liner_threshold": _of("pressure", allowed="length"),
    "bladder_elasticity": _of("length", allowed="pressure"),
    "contraction_limit": _of("length", allowed="pressure"),
    "end_cap": _of("pressure|length"),
    "fibre_stretch": _of("pressure", allowed="length"),
    "braid_friction": _of("history", allowed="pressure|length|velocity|pressure rate"),
    "viscosity": _of("velocity", allowed="pressure rate|history"),
    "creep": _of("history", allowed="pressure|length"),
    "temperature_stiffening": _of("temperature", allowed="pressure|length"),
    "dead_volume": _of(_FLOW, allowed="pressure|length"),
    "polytropic": _of(_FLOW, allowed="pressure|length|velocity"),
    "leak": _of("pressure|history", allowed="length"),
    "flow_area": _of(_FLOW, allowed="pressure|length"),
    "critical_ratio": _of(_FLOW, allowed="pressure|length"),
    "supply_droop": _of(_FLOW, allowed="pressure|length"),
    "valve_delay": _of(_FLOW, allowed="pressure|length"),
    "valve_delay_pressure": _of(_FLOW, allowed="pressure|length"),
    "transport_delay": _of(_FLOW, allowed="pressure|length"),
    "link_friction": _of("history|velocity", allowed="pressure|length|pressure rate"),
    "payload": _of(allowed="pressure|length"),
    "pressure_zero": _of("length|pressure", same_in="pressure"),
    "pressure_gain": _of("pressure", allowed="length"),
    "pressure_lag": _of(_FLOW, allowed="pressure|length"),
    "force_zero": _of(allowed="pressure|length"),
    "force_gain": _of("pressure|length"),
    "length_label": _of("pressure|length"),
    "camera_scale": _of("pressure|length"),
    "camera_distortion": _of("length", allowed="pressure"),
    "camera_delay": _of("velocity", allowed="pressure rate|history|pressure|length"),
    "wear": _of("order", allowed="pressure|length"),
    "pressure_ripple": _of("history", allowed="pressure|length|pressure rate"),
    "local_buckle": _of("pressure", "length"),
    "slide_stick": _of("velocity|history", "length", allowed="pressure|pressure rate"),
    "supply_surge": _of("history", allowed="pressure|pressure rate"),
    "mains_pickup": _of("history"),
    "cell_gradient": _of("history"),
    "mount_backlash": _of("pressure", allowed="length"),
    "weeping_valve": _of("pressure|history", allowed="length"),
    "pixel_locking": _of("length", allowed="pressure"),
    "coil_heating": _of(_FLOW, allowed="pressure|order|length"),
}
"""By id of the effect; those outside the catalogue stand last."""
FROM_TRIAL_TO_TRIAL = {
    "pressure_zero": (1, 2, 3), "force_zero": (1, 2, 3), "length_label": (2,)
}  # fmt: skip
"""Forms of effects whose equation holds the number or the time of a trial, or its mounting: their
gap depends on the order of the trials as well."""


def inputs_right(
    effects: tuple[str, ...], shares: Mapping[str, float], channel: str | None = None,
    forms: tuple[int | None, ...] = (),
) -> bool:  # fmt: skip
    """Whether the inputs of a term are those of the hidden effects.

    Every needed input has a share of `SMALL` or more, and no input that has nothing to do with any
    of the effects has. An effect that is the same everywhere in the term's channel needs none.
    `forms` are those in which the effects are hidden, where they are known.
    """
    found = {name for name, share in shares.items() if share >= SMALL}
    known = [TRUE_INPUTS[name] for name in effects]
    may = frozenset[str]().union(*(one.allowed.union(*one.needed) for one in known))
    if any(f in FROM_TRIAL_TO_TRIAL.get(name, ()) for name, f in zip(effects, forms, strict=False)):
        may |= {"order"}
    needed = [one for each in known if each.same_in != channel for one in each.needed]
    return found <= may and all(found & one for one in needed)
