"""The force changes slowly from trial to trial."""

from __future__ import annotations

import numpy as np

from plant.constants import PlantConstants
from plant.effects.arguments import Array, Context, Params, Points, Shape, Values
from plant.effects.effect import Effect, InDiagnosis, InPlant, Parameter, Search
from plant.effects.reference import TYPICAL_FORCE_N

PER_TRIAL = 52  # change of force per trial


def _slots(values: Values, c: PlantConstants) -> dict[int, float]:
    return {PER_TRIAL: float(values["percent_per_100_trials"]) / 1e4}


def _scale(
    pull: Array, params: Params, p: Array, length: Array, temperature: Array, trials: Array,
    braid: object,
) -> Array:  # fmt: skip
    return pull * (1.0 + params[PER_TRIAL] * trials)


def _force(
    points: Points, p: Array, length: Array, base: Array, shape: Shape, context: Context
) -> Array:
    order = context.order[points.trial] / 100.0
    power = shape.get("power", 1.0)
    if power != 1.0:
        order = order**power
    return 0.01 * order * (np.full(len(p), TYPICAL_FORCE_N) if "additive" in shape else base)


WEAR = Effect(
    "wear",
    "drift",
    "any",
    "a slow change with trial order, cycles or days, not tied to temperature",
    (Parameter("percent_per_100_trials", "%", "change of force", -50, 50),),
    "comparisons within one trial, and of trials close together",
    ("creep", "temperature_stiffening"),
    "repeat the first trial last, at the same temperature and after the same rest",
    equation="braid force x (1 + percent / 100 x trials / 100)",
    source="linear trend, as in a drift test of repeated trials",
    standard="none needed: the first trial repeated last",
    plant=InPlant(slots=_slots, scale=_scale),
    diagnosis=InDiagnosis(force=_force),
    search=Search(
        step=1.0,
        sign=0,
        blocks=("force", "load"),
        shapes=({}, {"power": 0.5}, {"additive": 1.0}, {"power": 2.0}),
        free={"power": (0.3, 3.0)},
    ),
)
