"""Effects that installed packages bring under the entry points `pamrig.effects`.

The value of an entry point is an `Effect`. Its functions are compiled with those of the catalogue,
so that the first simulation after a package was installed compiles anew.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from functools import cache
from importlib.metadata import EntryPoint, entry_points

from plant.constants import nominal
from plant.effects.effect import Effect
from plant.errors import PlantError
from plant.physics.layout import FREE_SLOT, PARAMS_SIZE

GROUP = "pamrig.effects"


@cache
def installed_effects() -> tuple[Effect, ...]:
    """What is installed, in order of names.

    Raises:
        PlantError: names the entry point that cannot be loaded or is no effect.
    """
    points = sorted(entry_points(group=GROUP), key=lambda point: point.name)
    return tuple(_load(point) for point in points)


def _load(point: EntryPoint) -> Effect:
    where = f"{GROUP}: {point.name} = {point.value}"
    try:
        effect = point.load()
    except Exception as error:
        raise PlantError(f"{where} cannot be loaded: {type(error).__name__}: {error}") from error
    if not isinstance(effect, Effect):
        raise PlantError(f"{where} is not an Effect")
    if effect.id != point.name:
        raise PlantError(f"{where} has the id {effect.id!r}; both must be the same")
    used = _slots_of(effect)
    if used and not FREE_SLOT <= min(used) <= max(used) < PARAMS_SIZE:
        raise PlantError(
            f"{where} uses slots {sorted(used)}; allowed {FREE_SLOT} to {PARAMS_SIZE - 1}"
        )
    return effect


def _slots_of(effect: Effect) -> set[int]:
    if effect.plant.slots is None:
        return set()
    values = {p.name: p.choices[0] if p.choices else float(p.low) for p in effect.parameters}
    return set(effect.plant.slots(values, nominal()))


def together(own: Iterable[Effect], brought: Iterable[Effect]) -> tuple[Effect, ...]:
    """The catalogue with installed effects behind it.

    Confusion is mutual: an effect that an installed one can be taken for names it, too.

    Raises:
        PlantError: an id is taken, two effects share a slot, or one is confused with none.
    """
    known = {effect.id: effect for effect in own}
    taken: dict[int, str] = {}
    for effect in brought:
        if effect.id in known:
            raise PlantError(f"{GROUP}: {effect.id!r} is an effect already")
        for slot in _slots_of(effect):
            if slot in taken:
                raise PlantError(f"{GROUP}: {effect.id!r} and {taken[slot]!r} share slot {slot}")
            taken[slot] = effect.id
        for other in effect.mistaken_for:
            if other not in known:
                raise PlantError(f"{GROUP}: {effect.id!r} is mistaken for {other!r}, unknown")
            if effect.id not in known[other].mistaken_for:
                named = (*known[other].mistaken_for, effect.id)
                known[other] = replace(known[other], mistaken_for=named)
        known[effect.id] = effect
    return tuple(known.values())
