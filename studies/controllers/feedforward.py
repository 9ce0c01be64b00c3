"""Feed-forward from the link equations (section 1.6.2), with a slow integral.

The torques of the reference motion (inverse dynamics with damping) are converted to pressures by
the muscle model at the reference angles. They are sent ahead of time by the delay of the pressure
loop. As section 1.6.2 requires, feedback is added to this open loop: an integral of the error with
one rate for all joints. The rate is a third of that at which the nominal model starts to oscillate
(a gain margin of 3).
"""

from __future__ import annotations

import numpy as np

from plant.arrays import Array
from plant.links.dynamics import inverse_dynamics
from studies.controllers.loop import HOST_MS
from studies.controllers.model import Linear
from studies.controllers.muscles import Pairs
from studies.controllers.reference import Reference

MARGIN = 3.0


def critical_integral_rate(model: Linear, dead_s: float) -> float:
    """Rate in 1/s at which integral action on all joints starts to oscillate (nominal model).

    The static gain of the model converts the integral to pressures, so that at low frequency
    q' = rate (reference - q) for every joint. Found by bisection on the sampled closed loop.
    """
    step = HOST_MS * 1e-3
    n = model.degrees
    a, b = model.sampled(step)
    delay = max(1, round(dead_s / step))
    size = 3 * n + delay * n + n
    turn = np.linalg.solve(model.gain, model.stiffness)

    def largest(rate: float) -> float:
        whole = np.zeros((size, size))
        whole[: 3 * n, : 3 * n] = a
        whole[: 3 * n, 3 * n : 4 * n] = b
        for k in range(delay - 1):
            at = 3 * n + k * n
            whole[at : at + n, at + n : at + 2 * n] = np.eye(n)
        last = 3 * n + (delay - 1) * n
        # The reading is added to the integral before the integral is sent.
        whole[last : last + n, size - n :] = turn
        whole[last : last + n, :n] = -rate * step * turn
        whole[size - n :, size - n :] = np.eye(n)
        whole[size - n :, :n] = -rate * step * np.eye(n)
        return float(np.abs(np.linalg.eigvals(whole)).max())

    low, high = 0.01, 1000.0
    for _ in range(60):
        middle = np.sqrt(low * high)
        if largest(middle) > 1.0:
            high = middle
        else:
            low = middle
    return float(np.sqrt(low * high))


class FeedForward:
    """Inverse dynamics sent `lead_s` ahead, and an integral of the error at `rate` (1/s)."""

    def __init__(
        self, pairs: Pairs, model: Linear, lead_s: float, rate: float, late_s: float = 0.002
    ) -> None:
        self.pairs = pairs
        self.lead_s = lead_s
        self.rate = rate
        self._late_s = late_s
        self._turn = np.linalg.solve(model.gain, model.stiffness)
        self._integral = np.zeros(model.degrees)
        self._reference: Reference | None = None

    def start(self, reference: Reference, q: Array) -> None:
        """Reset all states."""
        self._reference = reference.smooth
        self._integral = np.zeros(len(q))

    def torque(self, q: Array, qd: Array, qdd: Array) -> Array:
        """Torque of the nominal finger for a motion, N m (n,)."""
        return inverse_dynamics(self.pairs.finger.arm, q, qd, qdd)

    def delta(self, time_s: float, q: Array) -> Array:
        """Feed-forward of the reference at the time of arrival, and the integral."""
        assert self._reference is not None
        wanted, rate, acceleration = self._reference.at(time_s + self.lead_s)
        ahead = self.pairs.delta(wanted, self.torque(wanted, rate, acceleration))
        due, _, _ = self._reference.at(time_s - self._late_s)
        self._integral += self.rate * HOST_MS * 1e-3 * (self._turn @ (due - q))
        self._integral = np.clip(self._integral, -self.pairs.mean_kpa, self.pairs.mean_kpa)
        return np.asarray(ahead + self._integral)
