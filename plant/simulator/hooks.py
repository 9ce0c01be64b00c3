"""What all effects of the catalogue add to the plant, put together for compiled code.

Each name below is one function of `plant.effects.effect.InPlant`, run through every effect that has
it, in the order of the catalogue. An effect that is off leaves its argument as it is.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce
from typing import Any

from plant.compiled import inlined
from plant.effects.catalogue import CATALOGUE

Compiled = Callable[..., Any]


def functions(hook: str) -> list[Compiled]:
    """The functions of one name that the effects of the catalogue have."""
    made = [getattr(effect.plant, hook) for effect in CATALOGUE.values()]
    return [function for function in made if function is not None]


def _chained(hook: str) -> Compiled:
    """One function that passes its first argument through all functions of a name."""

    def unchanged(value: Any, *at: Any) -> Any:
        return value

    return reduce(_after, map(inlined, functions(hook) or [unchanged]))


def _after(first: Compiled, then: Compiled) -> Compiled:
    @inlined
    def both(value: Any, *at: Any) -> Any:
        return then(first(value, *at), *at)

    return both


def _in_turn(hook: str) -> Compiled:
    """One function that calls all functions of a name, which return nothing."""

    def nothing(*at: Any) -> None:
        pass

    return reduce(_and, map(inlined, functions(hook) or [nothing]))


def _and(first: Compiled, then: Compiled) -> Compiled:
    @inlined
    def both(*at: Any) -> None:
        first(*at)
        then(*at)

    return both


push = _chained("push")
threads = _chained("threads")
inner = _chained("inner")
scale = _chained("scale")
add = _chained("add")
transient = _chained("transient")
stiffness = _chained("stiffness")
damping = _chained("damping")
upstream = _chained("upstream")
outward = _chained("outward")
mass = _chained("mass")
drag = _chained("drag")
drag_stiffness = _chained("drag_stiffness")
slide = _in_turn("slide")
follow = _in_turn("follow")
