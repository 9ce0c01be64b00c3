"""The force stage: measured pressure, length, speed and history in, predicted force out.

Nominal physics is `plant.physics.muscle`; what the effects in force add to it stands in their files
(`plant.effects`). Sensor effects act on what was read before it is fed in: a gauge that reads high
fed the model too much pressure.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from gap.effects.recording import MOUNTING
from gap.effects.terms import Active, Term, terms
from plant.arrays import Array
from plant.constants import STANDARD_GRAVITY_M_S2, PlantConstants
from plant.effects.arguments import Context, Points, Shape
from plant.effects.effect import InDiagnosis
from plant.effects.sensors.linearity import BEYOND

_Linearity = Callable[[Array, float, Shape, Context], Array]
_Bend = tuple[_Linearity, Term]
"""How a scale bends, and the effect in force that bends it."""

_INVERTED = 5
_INVERTED_M = 1e-12
"""Most steps of an inversion, and the step from which on it is exact."""
_STRAIGHTENED = 40
_STRAIGHTENED_SHARE = 1e-4
"""Most steps of Newton's method that free a reading of a bend, and that of its slope, as a share of
the largest reading; a hundredth of which ends it."""
_NODES = 1024
"""Readings at which a scale that bends is straightened where there are far more."""
_LEAST_SLOPE = 0.25
_FARTHEST_M = 0.02
"""No camera that is called one shows a length this far from the true one."""


def true_length(points: Points, active: Active, c: PlantConstants) -> Array:
    """Length in m behind what was read or written down."""
    length = points.length
    acting = terms(active)
    mountings = [term for term in acting if term.diagnosis is MOUNTING]
    if mountings:
        # All in one pass: there may be as many mountings as trials. The last entry is for -1.
        numbers = [int(term.shape["number"]) for term in mountings]
        off = np.zeros(max(*numbers, int(points.mounting.max(initial=-1))) + 2)
        for number, term in zip(numbers, mountings, strict=True):
            off[number] += term.amount * 1e-3
        length = np.where(points.held, length + off[points.mounting], length)
    for term in acting:
        if term.diagnosis.length is not None and term.diagnosis is not MOUNTING:
            length = length + term.diagnosis.length(points, term.amount, term.shape, c)
    maps = [term for term in acting if term.diagnosis.camera is not None]
    seen = ~points.held
    if not maps or not seen.any():
        return length
    length = length.copy()
    length[seen] = _behind(length[seen], maps, c)
    return length


def _behind(read: Array, maps: list[Term], c: PlantConstants) -> Array:
    """True length in m that a camera shows as `read`: Newton's method, the slope kept positive.

    A lens bends what is there, not what it shows; far out the two differ.
    """
    true = np.clip(read - _error(maps, read, c), read - _FARTHEST_M, read + _FARTHEST_M)
    for _ in range(_INVERTED if any(term.diagnosis.camera_bends for term in maps) else 1):
        at = _error(maps, true, c)
        slope = 1.0 + (_error(maps, true + 1e-6, c) - at) / 1e-6
        before = true
        true = true - (true + at - read) / np.maximum(slope, _LEAST_SLOPE)
        true = np.clip(true, read - _FARTHEST_M, read + _FARTHEST_M)
        if np.abs(true - before).max() < _INVERTED_M:
            break
    return np.asarray(true)


def read_minus_true(active: Active, length: Array, c: PlantConstants) -> Array:
    """Error of the camera's reading in m at true length `length`, the same at all times."""
    return _error(terms(active), length, c)


def _error(maps: list[Term], length: Array, c: PlantConstants) -> Array:
    made = np.zeros(len(length))
    for term in maps:
        if term.diagnosis.camera is not None:
            made += term.diagnosis.camera(length, term.amount, term.shape, c)
    return made


def true_pressure(points: Points, active: Active, context: Context) -> Array:
    """Gauge pressure in Pa behind what was read."""
    p = gauge_straightened(points.pressure, active, context)
    for term in terms(active):
        if term.diagnosis.pressure is not None:
            p = term.diagnosis.pressure(p, points, term.amount, term.shape)
    for term in terms(active):
        if term.sensors.pressure is not None and _straight(term, _of_gauge):
            gain, zero_kpa = term.sensors.pressure(term.amount)
            p = (p - zero_kpa * 1e3) / (1.0 + gain)
    # At the lower end of the gauge the muscle is vented: nothing is left, whatever the zero is.
    return np.where(points.clipped, np.minimum(p, 0.0), p) if points.clipped.any() else p


def gauge_shows(straight: Array, active: Active, context: Context) -> Array:
    """What a gauge shows where one with a straight scale would show `straight`, Pa."""
    return _bent(straight, _bends(active, _of_gauge), context)


def gauge_straightened(shown: Array, active: Active, context: Context) -> Array:
    """What a gauge with a straight scale would show where this one shows `shown`, Pa."""
    return _straightened(shown, _bends(active, _of_gauge), context)


_Of = Callable[[InDiagnosis], _Linearity | None]


def _straight(term: Term, of: _Of) -> bool:
    """Whether a term leaves the scale of a sensor straight: a shape without numbers does."""
    return of(term.diagnosis) is None or not term.shape


def _bends(active: Active, of: _Of) -> list[_Bend]:
    """The bends of one sensor."""
    on = [(of(term.diagnosis), term) for term in terms(active) if term.shape]
    return [(bend, term) for bend, term in on if bend is not None]


def _of_gauge(on: InDiagnosis) -> _Linearity | None:
    return on.pressure_linearity


def _of_cell(on: InDiagnosis) -> _Linearity | None:
    return on.force_linearity


def _bent(straight: Array, bends: list[_Bend], context: Context) -> Array:
    """What scales that bend show where straight ones show `straight`."""
    shown = straight
    for bend, term in bends:
        shown = shown + bend(straight, term.amount, term.shape, context)
    return shown


def _straightened(shown: Array, bends: list[_Bend], context: Context) -> Array:
    if not bends or not len(shown):
        return shown
    if len(shown) > 2 * _NODES and not np.isnan(shown).all():
        low, high = float(np.nanmin(shown)), float(np.nanmax(shown))
        numbers = tuple((b, t.amount, tuple(sorted(t.shape.items()))) for b, t in bends)
        scale = _Scale(low, high, context.full_pa, context.full_n, numbers, bends, context)
        return np.interp(shown, *_straight_nodes(scale))
    straight = shown
    step = _STRAIGHTENED_SHARE * max(float(np.nanmax(np.abs(shown), initial=0.0)), 1e-9)
    bent = _bent(straight, bends, context)
    pace = np.ones_like(straight)
    for _ in range(_STRAIGHTENED):
        slope = (_bent(straight + step, bends, context) - bent) / step
        nearer = pace * (shown - bent) / np.maximum(slope, _LEAST_SLOPE)
        then = _bent(straight + nearer, bends, context)
        # Across a strong bend a whole step may lead to and fro for ever.
        better = np.abs(shown - then) <= np.abs(shown - bent)
        straight = np.where(better, straight + nearer, straight)
        bent = np.where(better, then, bent)
        pace = np.where(better, 1.0, 0.5 * pace)
        if float(np.nanmax(np.abs(nearer), initial=0.0)) < 0.01 * step:
            break
    return straight


@dataclass(frozen=True)
class _Scale:
    """A scale that bends, between two readings.

    Attributes:
        full_pa, full_n: of the context; nothing else of it bends a scale.
        numbers: the bends with their amounts and shapes, to compare scales by.
    """

    low: float
    high: float
    full_pa: float
    full_n: float
    numbers: tuple[Hashable, ...]
    bends: list[_Bend] = field(compare=False)
    context: Context = field(compare=False)


@lru_cache(maxsize=64)
def _straight_nodes(scale: _Scale) -> tuple[Array, Array]:
    """Readings of a scale that bends, and what a straight one would show, shape (nodes,) each.

    Many readings lie close together: between so many nodes a scale is straight, but where it stops
    changing. They are kept: no constant of the plant moves them.
    """
    full = BEYOND * np.array([scale.full_pa, scale.full_n])
    ends = _bent(full, scale.bends, scale.context)
    within = ends[(ends > scale.low) & (ends < scale.high)]
    nodes = np.sort(np.r_[np.linspace(scale.low, scale.high, _NODES), within])
    return nodes, _straightened(nodes, scale.bends, scale.context)


def muscle_force(points: Points, active: Active, context: Context) -> Array:
    """True pull of the muscle in N at every point."""
    c = context.constants
    p = true_pressure(points, active, context)
    length = true_length(points, active, c)
    push, effective, braid = p, length, np.full(len(p), c.braid_length_m)
    acting = terms(active)
    for term in acting:
        on = term.diagnosis
        if on.lost is not None:
            push = push - on.lost(p, term.amount, term.shape)
        if on.shortened is not None:
            effective = effective - on.shortened(p, length, term.amount, term.shape, c)
        if on.stretch is not None:
            braid = braid * (1.0 + on.stretch(p, length, term.amount, term.shape, c))
    if context.law is None:
        # `braid_force` with a braid length of each point's own.
        slope = push / (4.0 * np.pi * c.turns**2)
        base = np.asarray(slope * (3.0 * effective * effective - braid * braid))
    else:
        # A braid longer by a factor: the law of a muscle scaled in length, its pull in area.
        longer = braid / c.braid_length_m
        base = np.asarray(context.law(push, effective / longer) * longer**2)
    force = base
    for term in acting:
        if term.diagnosis.force is not None:
            added = term.diagnosis.force(points, p, length, base, term.shape, context)
            force = force + term.amount * added
    return force


def rest_pull(points: Points, tared: Array, active: Active, context: Context) -> Array:
    """Pull in N of the muscle, vented, at the lengths (m) where its force was set to zero.

    The nominal muscle pulls nothing there, so a tare takes nothing away; rubber and a limit of the
    contraction do not ask for pressure. Zero where it is not known where the tare was made.
    """
    none = np.zeros(len(tared))
    pull = none
    for term in terms(active):
        if term.diagnosis.at_rest and term.diagnosis.force is not None:
            added = term.diagnosis.force(points, none, tared, none, term.shape, context)
            pull = pull + term.amount * added
    return np.where(np.isnan(tared), 0.0, pull)


def force_read(force: Array, active: Active, context: Context) -> Array:
    """What the force sensor shows at true force `force`."""
    for term in terms(active):
        if term.sensors.force is not None and _straight(term, _of_cell):
            gain, zero = term.sensors.force(term.amount)
            force = force * (1.0 + gain) + zero
    return _bent(force, _bends(active, _of_cell), context)


def force_true(reading: Array, active: Active, context: Context) -> Array:
    """True force behind a reading."""
    reading = _straightened(reading, _bends(active, _of_cell), context)
    for term in reversed(terms(active)):
        if term.sensors.force is not None and _straight(term, _of_cell):
            gain, zero = term.sensors.force(term.amount)
            reading = (reading - zero) / (1.0 + gain)
    return reading


def load_pull(points: Points, active: Active, context: Context) -> Array:
    """Force in N that the hung load asks of the muscle: m (g - L'') - c L' - friction."""
    mass = points.mass
    friction = np.zeros(len(mass))
    for term in terms(active):
        on = term.diagnosis
        if on.mass is not None:
            mass = mass + on.mass(points, term.amount, term.shape, context.constants)
        if on.drag is not None:
            friction = friction + term.amount * on.drag(points, term.shape)
    damping = context.constants.load_damping_n_s_m * points.rate
    return np.asarray(mass * (STANDARD_GRAVITY_M_S2 - points.acceleration) - damping - friction)


def drag_slack(points: Points, active: Active) -> tuple[Array, Array]:
    """How much less and how much more than `load_pull` takes the friction of the load may be, N.

    A load that hardly moves is held by as much friction as it takes, not by all there may be.
    """
    least, most = np.zeros(len(points.mass)), np.zeros(len(points.mass))
    for term in terms(active):
        on = term.diagnosis
        if on.drag is None or on.drag_range is None:
            continue
        ends = on.drag_range(points, term.shape)
        if ends is None:
            continue
        drag, (low, high) = on.drag(points, term.shape), ends
        least = least + term.amount * np.minimum(low - drag, 0.0)
        most = most + term.amount * np.maximum(high - drag, 0.0)
    return least, most
