"""The joint or slide that carries the load rubs."""

from __future__ import annotations

import numpy as np

from plant.constants import PlantConstants
from plant.effects.arguments import Array, Params, Points, Shape, Values
from plant.effects.effect import Effect, InDiagnosis, InPlant, Parameter, Search, same_numbers
from plant.effects.trials import in_order
from plant.physics.layout import LENGTH

FORCE, TRAVEL = 60, 61  # N; m of motion after which the link slips
STATE = 28  # slip, -1 to 1


def slip_after(state: Params, params: Params, dlength: float) -> float:
    """Slip after a further `dlength` of motion.

    One elasto-slip element (Prandtl; Armstrong-Helouvry, Dupont and Canudas de Wit 1994 on
    pre-sliding): it sticks like a stiff spring and slips at its limit, whatever the speed.
    """
    return float(min(1.0, max(-1.0, state[STATE] + dlength / params[TRAVEL])))


def _slots(values: Values, c: PlantConstants) -> dict[int, float]:
    return {FORCE: float(values["friction_n"]), TRAVEL: float(values["travel_mm"]) * 1e-3}


def _slide(state: Params, params: Params, dp: float, dlength: float) -> None:
    if params[FORCE] != 0.0:
        state[STATE] = slip_after(state, params, dlength)


def _drag(drag: float, state: Params, params: Params, length: float) -> float:
    if params[FORCE] != 0.0:
        return float(drag + params[FORCE] * slip_after(state, params, length - state[LENGTH]))
    return drag


def _drag_stiffness(bound: float, params: Params) -> float:
    if params[FORCE] != 0.0:
        return float(bound + params[FORCE] / params[TRAVEL])
    return bound


def _sliding(points: Points, shape: Shape) -> Array:
    """Direction of sliding, -1 to 1; settled points have come the way their table says."""
    if "travel_mm" in shape:
        return _slip(points, points.length / (shape["travel_mm"] * 1e-3))
    speed = points.rate * 1e3
    knee = "rest_knee_mm_s" if "rest_knee_mm_s" in shape else "knee_mm_s"
    slip = np.tanh(speed / shape[knee])
    if "fall_mm_s" in shape:  # Stribeck's part, gone at speed
        slip = slip * np.exp(-((speed / shape["fall_mm_s"]) ** 2))
    come = -points.direction
    if "step_mm" in shape:
        # A load still creeps where a point is called settled, the less the shorter its last step.
        step = np.abs(np.diff(points.length, prepend=np.nan)) * 1e3
        step[points.first[:-1][points.first[:-1] < len(step)]] = np.inf
        come = come * -np.expm1(-step / shape["step_mm"])
    # The rows of a table of settled points are no path: only a stated direction tells.
    return np.where(points.direction != 0.0, come, np.where(points.settled, 0.0, slip))


def _range(points: Points, shape: Shape) -> tuple[Array, Array] | None:
    """Least and most slip, -1 to 1, of a load at speeds at which it may as well stick.

    Between none and all of it, with the sign of the motion, until it has come some way; where noise
    hides the sign, of either.
    """
    knee = shape.get("rest_knee_mm_s")
    if knee is None:
        return None
    drag = _sliding(points, shape)
    path = (points.direction == 0.0) & ~points.settled
    hidden = _HIDDEN_SD * points.rate_sd * 1e3 + _AT_REST * knee
    slow = np.tanh((points.rate * 1e3 - hidden) / knee)
    fast = np.tanh((points.rate * 1e3 + hidden) / knee)
    # Noise takes a part of a slip back: two thirds of it count as all of it.
    slip = np.where(path, _slip(points, points.length / (0.6 * _SURE_MM * 1e-3)), 0.0)
    sure = np.where(slip * points.rate > 0.0, np.clip(1.5 * slip, -1.0, 1.0), 0.0)
    least = np.where(path, np.minimum(slow, np.maximum(sure, 0.0)), drag)
    most = np.where(path, np.maximum(fast, np.minimum(sure, 0.0)), drag)
    return least, most


_HIDDEN_SD = 2.0
"""Sd of a speed within which its sign is not known. A matter of definition."""
_SURE_MM = 1.0
"""Way after a turn on which a slide comes to rub in full, whatever its pre-sliding. Set on: two
sets of several effects, 1060 and 1119."""
_AT_REST = 3.0
"""Knees of the speed below which a load is at rest: its friction may have either sign."""


def _slip(points: Points, travel: Array) -> Array:
    """Slip along each trial of elements that stick like springs, -1 to 1.

    A load that sticks after it has turned takes what the muscle no longer pulls, settled or not.
    The path of settled points is that of their directions; nothing is known of how a load that may
    have bounced came to the first of them.
    """
    from plant.physics import paths

    at = in_order(points)
    slip, made = np.zeros(len(at)), np.empty(len(at))
    paths.slip(points.first, np.ascontiguousarray(travel[at]), slip)
    made[at] = slip
    return np.where(points.settled & (points.direction == 0.0), 0.0, made)


LINK_FRICTION = Effect(
    "link_friction",
    "load",
    "load",
    "friction in the joint or slide that carries the load",
    (
        Parameter("friction_n", "N", "friction force of the slide", 0, 100),
        Parameter("travel_mm", "mm", "motion after which it slips", 0.002, 2, 0.02),
    ),
    "isometric tests altogether; gas traces at constant length",
    ("braid_friction", "viscosity", "payload"),
    "isometric against isotonic loops: friction of the slide is only in the latter",
    equation="m L'' = m g - F - c L' - friction z, dz = dL / travel, |z| <= 1",
    source="Armstrong-Helouvry, Dupont and Canudas de Wit 1994 (pre-sliding)",
    standard="a force sensor between muscle and load",
    constants=("load_damping_n_s_mm",),
    plant=InPlant(slots=_slots, slide=_slide, drag=_drag, drag_stiffness=_drag_stiffness),
    diagnosis=InDiagnosis(drag=_sliding, drag_range=_range),
    search=Search(
        step=0.5,
        sign=1,
        blocks=("load",),
        shapes=(
            {"knee_mm_s": 0.3},
            {"knee_mm_s": 2.0},
            {"knee_mm_s": 10.0},
            {"travel_mm": 0.1},
            {"travel_mm": 0.5},
            {"knee_mm_s": 0.3, "fall_mm_s": 6.0},
            {"knee_mm_s": 1.0, "step_mm": 1.5},
            {"rest_knee_mm_s": 0.07},
        ),
        free={
            "knee_mm_s": (0.05, 30.0),
            "travel_mm": (0.02, 3.0),
            "fall_mm_s": (1.0, 30.0),
            "step_mm": (0.2, 10.0),
            "rest_knee_mm_s": (0.02, 0.1),
        },
        plant_shape={"travel_mm": 0.02},
        plant_misfit=0.5,  # a stiff slide: the direction of a bouncing load hangs on the frames
        as_plant=same_numbers(travel_mm="travel_mm"),
    ),
)
