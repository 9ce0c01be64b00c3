"""The catalogue of effects: what a real bench may do that the nominal plant does not.

Verdicts, rig files (`[effects.<id>]`), docs and blind checks all use these ids. A new effect is
one file in a room and its name in the tuple of that room; an installed package can bring one, too.
"""

from __future__ import annotations

from plant.effects.drift import DRIFT
from plant.effects.effect import Effect
from plant.effects.gas import GAS
from plant.effects.installed import installed_effects, together
from plant.effects.load import LOAD
from plant.effects.muscle import MUSCLE
from plant.effects.sensors import SENSORS
from plant.effects.valve import VALVE

_EFFECTS = together((*MUSCLE, *GAS, *VALVE, *LOAD, *SENSORS, *DRIFT), installed_effects())

CATALOGUE: dict[str, Effect] = {effect.id: effect for effect in _EFFECTS}
"""All effects by id, in the order of the specification."""

FAMILIES: tuple[str, ...] = tuple(dict.fromkeys(effect.family for effect in _EFFECTS))
"""The families, in order of first appearance; "none" and "unknown" are verdicts beside them."""
