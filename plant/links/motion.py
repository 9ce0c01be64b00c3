"""Motion of an arm, free or under constant torques, and the change of its energy.

Two methods: classical Runge-Kutta of order 4, and implicit Gauss of order 6 with three stages. The
second is symmetric in time, so energy errors of a long motion stay bounded (Hairer, Lubich and
Wanner 2006, sections II.1 and V.1).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from plant.arrays import Array
from plant.errors import LinkError
from plant.links.arm import Arm
from plant.links.dynamics import total_energy
from plant.links.integrate import METHODS, swing_states


@dataclass(frozen=True)
class Swing:
    """A motion: `time_s` (samples,), `q` and `qd` (samples, n), `energy_j` (samples,).

    `scale_j` is the largest kinetic energy, the reference for energy errors.
    """

    time_s: Array
    q: Array
    qd: Array
    energy_j: Array
    scale_j: float

    @property
    def drift(self) -> float:
        """Largest change of energy from the start, relative to `scale_j`."""
        return float(np.abs(self.energy_j - self.energy_j[0]).max() / self.scale_j)


def swing(
    arm: Arm,
    q: npt.ArrayLike,
    qd: npt.ArrayLike,
    duration_s: float,
    step_s: float = 2e-4,
    method: str = "gauss6",
    torque: npt.ArrayLike | None = None,
    every: int = 10,
) -> Swing:
    """Simulate an arm from an initial state, free or under constant joint torques.

    Args:
        arm: the arm, with its joint damping; joint ranges are ignored.
        q: initial angles (n,), rad.
        qd: initial rates (n,), rad/s.
        duration_s: duration.
        step_s: time step.
        method: "gauss6" or "rk4".
        torque: (n,), N m; None is 0.
        every: store every n-th step.

    Raises:
        LinkError: an unknown method, wrong shapes, a step that is not positive, or a step too long
            for the motion.
    """
    if method not in METHODS:
        raise LinkError(f"integration method {method!r}: choose one of {', '.join(METHODS)}")
    if not (step_s > 0.0 and math.isfinite(duration_s) and duration_s >= step_s and every >= 1):
        raise LinkError(
            f"step {step_s!r} s, duration {duration_s!r} s, every {every!r}: the step must be "
            "positive and not longer than the duration, and every must be at least 1"
        )
    n = arm.degrees
    start = np.zeros((3, n))
    for row, (name, given) in enumerate((("q", q), ("qd", qd), ("torque", torque))):
        if given is not None:
            values = np.asarray(given, dtype=float)
            if values.shape != (n,):
                raise LinkError(f"arm {arm.name!r}: {name} has shape {values.shape}, not ({n},)")
            start[row] = values
    steps = round(duration_s / step_s)
    states = np.empty((steps // every + 1, 2 * n))
    reached = swing_states(
        arm.table,
        arm.gravity,
        np.concatenate(start[:2]),
        start[2],
        step_s,
        every,
        METHODS.index(method),
        states,
    )
    if reached < len(states):
        raise LinkError(
            f"arm {arm.name!r}: {method} cannot follow the motion after "
            f"{reached * every * step_s:g} s with steps of {step_s:g} s; use shorter steps, and "
            "check that every joint moves some inertia"
        )
    angles, rates = states[:, :n].copy(), states[:, n:].copy()
    energy = total_energy(arm, angles, rates)
    kinetic = energy - total_energy(arm, angles, np.zeros_like(rates))
    time: Array = np.arange(len(states)) * np.float64(every * step_s)
    return Swing(time, angles, rates, energy, float(max(kinetic.max(), 1e-300)))
