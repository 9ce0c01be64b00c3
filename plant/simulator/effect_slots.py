"""Effects as the numbers that the compiled bench takes: parameter slots over the nominal ones."""

from __future__ import annotations

from plant.constants import PlantConstants
from plant.effects.effects import Effects
from plant.physics import layout


def effect_slots(c: PlantConstants, effects: Effects) -> dict[int, float]:
    """Slots of the parameter array that differ from those of the nominal bench `c`.

    Effects on sensors (`plant.simulator.readings`) and on the label of the length leave no mark
    here, but for the lag of the pressure reading. Raises `PlantError` where an effect cannot be.
    """
    slots: dict[int, float] = {}
    for effect, values in effects.active():
        if effect.plant.slots is not None:
            slots.update(effect.plant.slots(values, c))
        if effect.plant.on_force:
            slots[layout.FORCE_EFFECTS] = 1.0
    return slots
