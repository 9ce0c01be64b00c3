"""The force relaxes for minutes after a step."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from plant.constants import PlantConstants
from plant.effects.arguments import Array, Context, Params, Points, Shape, Values
from plant.effects.effect import Effect, InDiagnosis, InPlant, Parameter, Search
from plant.errors import PlantError
from plant.physics.lag import follow
from plant.physics.layout import REMEMBERS

GAIN, TIME = 54, 55  # weight of each element; s, ELEMENTS of them
STATE = 23  # N, ELEMENTS followers of the lasting force
ELEMENTS = 4
_AFTER_S = 60.0
"""Time after a step at which the relaxation is stated."""


def times(fast: float, slow: float) -> Array:
    """Time constants of the elements in s, evenly spread over the logarithm of time."""
    return fast * (slow / fast) ** (np.arange(ELEMENTS) / (ELEMENTS - 1))


def gain(relaxation: float, time_constants: Array) -> float:
    """Weight of each element, so that a step has lost `relaxation` of itself after 60 s.

    Equal weights over the logarithm of time: the nearly straight line over log t that rubber
    shows (quasi-linear viscoelasticity, Fung 1993; on such muscles Vo-Minh, Tjahjowidodo, Ramon
    and Van Brussel 2011).
    """
    return relaxation / float(np.sum(-np.expm1(-_AFTER_S / time_constants)))


def _slots(values: Values, c: PlantConstants) -> dict[int, float]:
    fast, slow = float(values["fast_s"]), float(values["slow_s"])
    if not fast < slow:
        raise PlantError(f"effect 'creep': fast_s = {fast:g} must be below slow_s = {slow:g}")
    weight = gain(float(values["relaxation_percent"]) / 100.0, times(fast, slow))
    slots = {TIME + i: float(time) for i, time in enumerate(times(fast, slow))}
    return {**slots, GAIN: weight, REMEMBERS: 1.0} if weight != 0.0 else slots


def _transient(
    pull: Array, state: Params, params: Params, p: Array, length: Array, rate: Array
) -> Array:
    if params[GAIN] == 0.0:
        return pull
    crept = 0.0
    for i in range(ELEMENTS):
        crept += state[STATE + i]
    return pull - params[GAIN] * crept


def _follow(
    state: Params, params: Params, p0: float, pull0: float, pull: float, duration: float
) -> None:
    if params[GAIN] != 0.0:
        for i in range(ELEMENTS):
            slot = STATE + i
            state[slot] = follow(state[slot], pull0, pull, duration, params[TIME + i])


def _force(
    points: Points, p: Array, length: Array, base: Array, shape: Shape, context: Context
) -> Array:
    from plant.physics import paths

    slow = np.zeros(len(p))
    tau = shape["tau_s"]
    if not len(p) or (np.all(np.diff(points.first) <= 1) and np.isnan(points.taken).all()):
        return slow
    paths.lag(points.first, points.time_s, np.ascontiguousarray(base), tau, slow)
    if "settled" not in shape:
        # Fresh at the first sample; else what pulls there has done so for long.
        slow -= base[np.minimum(points.first[:-1], len(base) - 1)][points.trial]
    # The rows of a table are not seconds. It shows creep where it states when it was read.
    slow[points.settled] = 0.0
    _in_tables(points, base, tau, "settled" not in shape, slow)
    return np.asarray(-gain(0.01, np.array([tau])) * slow)


def _in_tables(points: Points, base: Array, tau: float, fresh: bool, slow: Array) -> None:
    """What has crept at settled points, each taken to pull from the point before it was read on."""
    for begin, end in pairwise(points.first):
        if begin == end or np.isnan(points.taken[begin]):
            continue
        order = begin + np.argsort(points.taken[begin:end])
        crept, last = (0.0 if fresh else base[order[0]]), 0.0
        for i in order:
            left = np.exp(-max(points.taken[i] - last, 0.0) / tau)
            crept = base[i] + (crept - base[i]) * left
            slow[i], last = crept, points.taken[i]


CREEP = Effect(
    "creep",
    "rate",
    "muscle",
    "force or length drifts for seconds to minutes after a step",
    (
        Parameter("relaxation_percent", "%", "of the step after 60 s", -50, 50),
        Parameter("fast_s", "s", "shortest time constant", 0.5, 60, 3.0),
        Parameter("slow_s", "s", "longest time constant", 5, 3600, 200.0),
    ),
    "the first second after a step; valve timing",
    ("braid_friction", "temperature_stiffening", "wear"),
    "hold one point for minutes, step away and back: creep starts anew at each step",
    equation="F - g sum m_i, tau_i dm_i/dt = F_e - m_i, four tau_i from fast_s to slow_s",
    source="Fung 1993 (quasi-linear viscoelasticity); Vo-Minh et al. 2011",
    standard="none needed: one point held for minutes",
    of_braid=True,
    plant=InPlant(slots=_slots, transient=_transient, follow=_follow),
    diagnosis=InDiagnosis(force=_force),
    search=Search(
        step=0.5,
        sign=1,
        blocks=("force", "load"),
        shapes=(
            *({"tau_s": tau} for tau in (1.5, 6.0, 25.0, 100.0)),
            *({"tau_s": tau, "settled": 1.0} for tau in (3.0, 12.0, 50.0)),
        ),
        free={"tau_s": (0.5, 400.0)},
        plant_shape={"tau_s": 25.0},
        plant_misfit=0.6,  # one time constant for four
    ),
)
