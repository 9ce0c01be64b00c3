"""Effects of the muscle itself and of its temperature, in the order of the specification."""

from __future__ import annotations

from plant.effects.effect import Effect
from plant.effects.muscle.bladder_elasticity import BLADDER_ELASTICITY
from plant.effects.muscle.braid_friction import BRAID_FRICTION
from plant.effects.muscle.contraction_limit import CONTRACTION_LIMIT
from plant.effects.muscle.creep import CREEP
from plant.effects.muscle.end_cap import END_CAP
from plant.effects.muscle.fibre_stretch import FIBRE_STRETCH
from plant.effects.muscle.liner_threshold import LINER_THRESHOLD
from plant.effects.muscle.temperature_stiffening import TEMPERATURE_STIFFENING
from plant.effects.muscle.viscosity import VISCOSITY

MUSCLE: tuple[Effect, ...] = (
    LINER_THRESHOLD,
    BLADDER_ELASTICITY,
    CONTRACTION_LIMIT,
    END_CAP,
    FIBRE_STRETCH,
    BRAID_FRICTION,
    VISCOSITY,
    CREEP,
    TEMPERATURE_STIFFENING,
)
