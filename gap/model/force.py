"""The force stage: measured pressure, length, speed and history in, predicted force out.

Nominal physics is `plant.physics.muscle`; on top come the effects of the catalogue in the shapes of
`gap.effects.candidates`. Sensor effects act on what was read before it is fed in: a gauge that
reads high fed the model too much pressure.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from gap.effects.candidates import Shape
from gap.model import history
from gap.model.features import Points
from plant.constants import PlantConstants
from plant.physics.muscle import liner_pressure

Array = npt.NDArray[np.float64]
Active = list[tuple[str, str, float, Shape]]
"""Effects in force: id, option (side or edge), amount of the headline parameter, shape."""

REFERENCE_C = 21.0
_REFERENCE_BRAID_M = 0.0884
_GRAVITY = 9.80665


@dataclass(frozen=True)
class Context:
    """What a law needs beside the points: constants, and the order of the trials from 0."""

    constants: PlantConstants
    order: Array


def true_length(points: Points, active: Active, c: PlantConstants) -> Array:
    """Length in m behind what was read or written down."""
    length = points.length
    for name, _, amount, shape in active:
        if name == "length_label":
            length = length + np.where(points.held, amount * 1e-3, 0.0)
        elif name == "mounting":
            here = points.held & (points.mounting == int(shape["number"]))
            length = length + np.where(here, amount * 1e-3, 0.0)
        elif name == "camera_delay":
            late = moved(points, points.length, amount * 1e-3) - points.length
            length = length + np.where(points.held, 0.0, late)
    maps = [one for one in active if one[0] in CAMERA_MAPS]
    return np.where(points.held, length, _behind(length, maps, c)) if maps else length


CAMERA_MAPS = ("camera_scale", "camera_distortion", "camera_zero")
"""Effects by which a camera shows another length than there is, the same at all times."""
_INVERTED = 5
_LEAST_SLOPE = 0.25
_FARTHEST_M = 0.02
"""No camera that is called one shows a length this far from the true one."""


def _behind(read: Array, maps: Active, c: PlantConstants) -> Array:
    """True length in m that a camera shows as `read`: Newton's method, the slope kept positive.

    A lens bends what is there, not what it shows; far out the two differ.
    """

    def error(length: Array) -> Array:
        made = np.zeros(len(length))
        for name, _, amount, shape in maps:
            made += read_minus_true(name, amount, shape, length, c)
        return made

    true = np.clip(read - error(read), read - _FARTHEST_M, read + _FARTHEST_M)
    for _ in range(_INVERTED if any(one[0] == "camera_distortion" for one in maps) else 1):
        at = error(true)
        slope = 1.0 + (error(true + 1e-6) - at) / 1e-6
        true = true - (true + at - read) / np.maximum(slope, _LEAST_SLOPE)
        true = np.clip(true, read - _FARTHEST_M, read + _FARTHEST_M)
    return np.asarray(true)


def _reference(c: PlantConstants) -> float:
    """Length in m that headline parameters are stated at: 60 mm of the usual braid."""
    return 0.06 * c.braid_length_m / _REFERENCE_BRAID_M


def _middle(c: PlantConstants) -> float:
    return 0.5 * (c.length_min_m + c.length_max_m)


def read_minus_true(
    name: str, amount: float, shape: Shape, length: Array, c: PlantConstants
) -> Array:
    """Error of the camera's reading in m at true length `length`."""
    if name == "camera_zero":
        return np.full(len(length), amount * 1e-3)
    if name == "camera_scale":
        origin = _middle(c) if "middle" in shape else 0.0
        return amount * 1e-2 * (length - origin)
    half = 0.5 * (c.length_max_m - c.length_min_m)
    if "edge" in shape:
        share = (length - c.length_min_m) / (2.0 * half)
    else:
        share = (length - _middle(c)) / half
    bend = np.abs(share) ** shape.get("power", 3.0)
    return np.asarray(amount * 1e-3 * (bend if "even" in shape else np.sign(share) * bend))


def true_pressure(points: Points, active: Active) -> Array:
    """Gauge pressure in Pa behind what was read."""
    p = points.pressure
    for name, _, amount, _shape in active:
        if name == "pressure_lag":
            p = p + amount * 1e-3 * points.pressure_slope
        elif name == "pressure_clock":
            p = moved(points, p, amount * 1e-3)
    for name, _, amount, _shape in active:
        if name == "pressure_gain":
            p = p / (1.0 + amount * 1e-2)
        elif name == "pressure_zero":
            p = p - amount * 1e3
    return p


def moved(points: Points, values: Array, ahead_s: float) -> Array:
    """Values of a signal `ahead_s` later, trial by trial, ends held; settled points stay."""
    if ahead_s == 0.0:
        return values
    made = values.copy()
    for a, b in zip(points.first[:-1].tolist(), points.first[1:].tolist(), strict=True):
        if b - a > 2 and not points.settled[a]:
            t = points.time_s[a:b]
            made[a:b] = np.interp(t + ahead_s, t, values[a:b])
    return made


def muscle_force(points: Points, active: Active, context: Context) -> Array:
    """True pull of the muscle in N at every point."""
    c = context.constants
    p = true_pressure(points, active)
    length = true_length(points, active, c)
    push, effective, braid = p, length, np.full(len(p), c.braid_length_m)
    for name, _, amount, shape in active:
        if name == "liner_threshold":
            push = push - _liner_loss(p, amount, shape)
        elif name == "end_cap":
            effective = effective - amount * 1e-3 * _end_cap(length, shape, c)
        elif name == "fibre_stretch":
            braid = braid * (1.0 + amount * 1e-2 * _stretch(p, length, shape, c))
    # `braid_force` with a braid length of each point's own.
    slope = push / (4.0 * np.pi * c.turns**2)
    force = np.asarray(slope * (3.0 * effective * effective - braid * braid))
    base = force
    for name, _, amount, shape in active:
        law = _ADDED.get(name)
        if law is not None:
            force = force + amount * law(points, p, length, base, shape, context)
    return force


def rest_pull(points: Points, tared: Array, active: Active, context: Context) -> Array:
    """Pull in N of the muscle, vented, at the lengths (m) where its force was set to zero.

    The nominal muscle pulls nothing there, so a tare takes nothing away; rubber and a limit of the
    contraction do not ask for pressure. Zero where it is not known where the tare was made.
    """
    none = np.zeros(len(tared))
    pull = none
    for name, _, amount, shape in active:
        if name in ("bladder_elasticity", "contraction_limit"):
            pull = pull + amount * _ADDED[name](points, none, tared, none, shape, context)
    return np.where(np.isnan(tared), 0.0, pull)


def _liner_loss(p: Array, lost_kpa: float, shape: Shape) -> Array:
    lost = lost_kpa * 1e3
    if "saturating" in shape:
        knee = max(abs(lost), 1.0) * 1.5
        return np.asarray(lost * (1.0 - np.exp(-np.maximum(p, 0.0) / knee)))
    width = shape["width_kpa"] * 1e3
    positive = np.maximum(p, 0.0)
    return np.asarray(np.where(p > 0.0, positive - liner_pressure(positive, lost, width), 0.0))


def _end_cap(length: Array, shape: Shape, c: PlantConstants) -> Array:
    grow = shape["grow"]
    if grow == 0.0:
        return np.ones(len(length))
    at = _reference(c)
    if grow < 0.0:
        return length / at
    rest = 1.02 * c.length_max_m
    return np.asarray(np.maximum((rest - length) / (rest - at), 0.0) ** grow)


def _stretch(p: Array, length: Array, shape: Shape, c: PlantConstants) -> Array:
    if "tension" in shape:
        # Tension of a thread: pressure on the wall, more where the muscle is thick and short.
        return p / 5e5 * (c.braid_length_m**2 - length**2) / (c.braid_length_m**2 - 0.06**2)
    share = np.maximum(p, 0.0) / 5e5
    return np.asarray(share ** shape["power"])


def _bladder(
    points: Points, p: Array, length: Array, base: Array, shape: Shape, context: Context
) -> Array:
    rest = shape["rest"] * context.constants.braid_length_m
    stretch = (length - rest) * 1e3
    if "cubic" in shape:
        at = (_reference(context.constants) - rest) * 1e3
        scale = 8.0
        return (stretch + (stretch / scale) ** 3 * scale) / (1.0 + 3.0 * (at / scale) ** 2)
    return stretch


def _limit(
    points: Points, p: Array, length: Array, base: Array, shape: Shape, context: Context
) -> Array:
    beyond = (length - context.constants.length_min_m) * 1e3 - 1.0
    if "knee_mm" in shape:
        loss = np.maximum(1.0 - beyond / shape["knee_mm"], 0.0) ** 2
    else:
        loss = np.exp(-np.clip(beyond, -3.0, None) / shape["decay_mm"])
    return -loss * (np.maximum(p, 0.0) / 3e5 if "pressure" in shape else 1.0)


_NOISE_TURNS = 3.0
"""Sd of a path's noise that is no turning back."""


def _turning(points: Points, travel: Array) -> Array:
    """A path without the turns that only its reading noise makes.

    Fibres that slip would come to rest at each of them, and friction would look too small.
    """
    if np.any(points.direction != 0.0):
        return np.ascontiguousarray(travel)
    half = np.zeros(len(points.first) - 1)
    for trial, (a, b) in enumerate(pairwise(points.first.tolist())):
        if b - a > 4:
            bend = travel[a + 1 : b - 1] - 0.5 * (travel[a : b - 2] + travel[a + 2 : b])
            half[trial] = _NOISE_TURNS * 1.4826 * float(np.median(np.abs(bend))) / np.sqrt(1.5)
    made = np.empty(len(travel))
    history.play(points.first, np.ascontiguousarray(travel), half, made)
    return made


def _friction(
    points: Points, p: Array, length: Array, base: Array, shape: Shape, context: Context
) -> Array:
    travel = points.path / (shape["kpa"] * 1e3) - length / (shape["mm"] * 1e-3)
    # Settled points bring their own direction where the table does not hold the whole path.
    slip = np.zeros(len(p))
    history.slip(points.first, _turning(points, travel), slip)
    slip = np.where(points.direction != 0.0, points.direction, slip)
    scale = np.maximum(p, 0.0) / 3e5 if shape["pressure"] else np.where(p > 2e3, 1.0, 0.0)
    return -slip * scale


def _viscosity(
    points: Points, p: Array, length: Array, base: Array, shape: Shape, context: Context
) -> Array:
    v = np.where(points.held, 0.0, points.rate) * 1e3
    knee = shape.get("knee_mm_s", 0.0)
    if knee:
        v = 10.0 * np.tanh(v / knee) / np.tanh(10.0 / knee)
    elif "power" in shape:
        v = 10.0 * np.sign(v) * (np.abs(v) / 10.0) ** shape["power"]
    return np.asarray(v * (np.maximum(p, 0.0) / 3e5 if "pressure" in shape else 1.0))


def _creep(
    points: Points, p: Array, length: Array, base: Array, shape: Shape, context: Context
) -> Array:
    slow = np.zeros(len(p))
    tau = shape["tau_s"]
    if np.all(np.diff(points.first) <= 1) or not len(p):
        return slow
    history.lag(points.first, points.time_s, np.ascontiguousarray(base), tau, slow)
    if "settled" not in shape:
        # Fresh at the first sample; else what pulls there has done so for long.
        slow -= base[np.minimum(points.first[:-1], len(base) - 1)][points.trial]
    return np.asarray(-0.01 * slow / (1.0 - np.exp(-60.0 / tau)))


def _temperature(
    points: Points, p: Array, length: Array, base: Array, shape: Shape, context: Context
) -> Array:
    warmer = np.nan_to_num(points.temperature - REFERENCE_C) * 0.01
    if "additive" in shape:
        return warmer * np.where(p > 1e3, 30.0, 0.0)
    weight = np.maximum(p, 2e4) / 5e5
    return np.asarray(warmer * base * weight ** shape.get("pressure", 0.0))


def _wear(
    points: Points, p: Array, length: Array, base: Array, shape: Shape, context: Context
) -> Array:
    order = context.order[points.trial] / 100.0
    power = shape.get("power", 1.0)
    if power != 1.0:
        order = order**power
    return 0.01 * order * (np.full(len(p), 30.0) if "additive" in shape else base)


_ADDED = {
    "bladder_elasticity": _bladder,
    "contraction_limit": _limit,
    "braid_friction": _friction,
    "viscosity": _viscosity,
    "creep": _creep,
    "temperature_stiffening": _temperature,
    "wear": _wear,
}


def force_read(force: Array, points: Points, active: Active) -> Array:
    """What the force sensor shows at true force `force`."""
    for name, _, amount, _shape in active:
        if name == "force_gain":
            force = force * (1.0 + amount * 1e-2)
        elif name == "force_zero":
            force = force + amount
    return force


def force_true(reading: Array, active: Active) -> Array:
    """True force behind a reading."""
    for name, _, amount, _shape in active:
        if name == "force_gain":
            reading = reading / (1.0 + amount * 1e-2)
        elif name == "force_zero":
            reading = reading - amount
    return reading


def load_pull(points: Points, active: Active, context: Context) -> Array:
    """Force in N that the hung load asks of the muscle: m (g - L'') - c L' - friction."""
    mass = points.mass
    friction = np.zeros(len(mass))
    for name, _, amount, shape in active:
        if name == "payload":
            # What hangs along (a hose, a guide) may weigh more the higher it is lifted.
            lifted = (_reference(context.constants) - points.length) * 1e3
            share = lifted / shape["lifted_mm"] if "lifted_mm" in shape else 0.0
            mass = mass + amount * (1.0 + share)
        elif name == "link_friction":
            friction = friction + amount * _slide(points, shape)
    damping = context.constants.load_damping_n_s_m * points.rate
    return np.asarray(mass * (_GRAVITY - points.acceleration) - damping - friction)


def _slide(points: Points, shape: Shape) -> Array:
    """Direction of sliding, -1 to 1; settled points have come the way their table says."""
    if "travel_mm" in shape:
        slip = np.zeros(len(points.length))
        travel = points.length / (shape["travel_mm"] * 1e-3)
        history.slip(points.first, np.ascontiguousarray(travel), slip)
    else:
        speed = points.rate * 1e3
        slip = np.tanh(speed / shape["knee_mm_s"])
        if "fall_mm_s" in shape:  # Stribeck's part, gone at speed
            slip = slip * np.exp(-((speed / shape["fall_mm_s"]) ** 2))
    come = -points.direction
    if "step_mm" in shape:
        # A load still creeps where a point is called settled, the less the shorter its last step.
        step = np.abs(np.diff(points.length, prepend=np.nan)) * 1e3
        step[points.first[:-1][points.first[:-1] < len(step)]] = np.inf
        come = come * -np.expm1(-step / shape["step_mm"])
    return np.where(points.direction != 0.0, come, slip)
