"""An adaptive law: the payload is learnt from the motion and goes into the feed-forward.

The desired compensation adaptation law (Sadegh and Horowitz 1990, Int. J. Robotics Research 9(3)),
the form of Slotine and Li's adaptive manipulator control (1987, ibid. 6(3)) whose regressor is of
the wanted motion, so that no noise enters it:

    torque = Y0(q_d, q_d', q_d'') + m Y(q_d, q_d', q_d'') + bias
    dm/dt  = gamma Y^T s,   s = e' + lambda e,   e = q_d - q

Y is the torque a kilogram at the tip takes, exact, from the link equations. m stays within 0 to
100 g. The feedback part of the published law is the muscles' own stiffness and damping, which the
pressures set. `bias` is the slow integral of `feedforward`, at a quarter of its rate, for what is
no payload; it begins with the reference's clock, when the payload has had the time of the approach
to show: else both would share one static error for good. Errors above 10 degrees teach nothing,
for the finger is then falling, or at a stop.

The rate gamma is set by what a constant error means: were all of it payload at the model's posture,
m would approach it at half of the rate that `feedforward` gives its integral. lambda lies at twice
the slowest oscillation's frequency, so that s does not feed that back as e'.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from plant.links import Arm
from plant.links.dynamics import inverse_dynamics
from rigs.controllers.feedforward import FeedForward
from rigs.controllers.loop import HOST_MS
from rigs.controllers.model import Linear
from rigs.controllers.muscles import Pairs
from rigs.controllers.reference import Reference

Array = npt.NDArray[np.float64]

MOST_KG = 0.1
BIAS_SHARE = 0.25
LEARNING_SHARE = 0.5
TEACHING_RAD = np.radians(10.0)
_PROBE_KG = 0.1


def payload_regressor(arm: Arm, q: Array, qd: Array, qdd: Array) -> Array:
    """Torque (n,) a kilogram at the tip takes in a motion, N m/kg; linear in the mass, so exact."""
    with_it = inverse_dynamics(arm.with_payload(_PROBE_KG), q, qd, qdd)
    return (with_it - inverse_dynamics(arm, q, qd, qdd)) / _PROBE_KG


class Adaptive(FeedForward):
    """Feed-forward that learns the payload; `note` is the estimate in kg."""

    def __init__(
        self, pairs: Pairs, model: Linear, lead_s: float, rate: float, late_s: float = 0.002
    ) -> None:
        super().__init__(pairs, model, lead_s, BIAS_SHARE * rate, late_s)
        self.mass_kg = 0.0
        self._arm = pairs.finger.arm
        self._carrying = self._arm.with_payload(_PROBE_KG)
        still = np.zeros(model.degrees)
        weight = payload_regressor(self._arm, model.q0, still, still)
        # A payload m bends the joints by K^-1 Y m; Y^T K^-1 Y is what a kilogram earns.
        earned = float(weight @ np.linalg.solve(model.stiffness, weight))
        self._lambda = 2.0 * 2.0 * np.pi / model.slowest_period_s
        # s = e' + lambda e: the rate of learning is gamma lambda Y^T K^-1 Y.
        self._gamma = LEARNING_SHARE * rate / (self._lambda * earned)
        self._last: Array | None = None

    @property
    def note(self) -> Array:
        """Estimated payload, kg."""
        return np.array([self.mass_kg])

    def start(self, reference: Reference, q: Array) -> None:
        """Forget the past, the payload included."""
        super().start(reference, q)
        self.mass_kg = 0.0
        self._last = None

    def torque(self, q: Array, qd: Array, qdd: Array) -> Array:
        """Nominal torque and that of the payload as far as it is known."""
        bare = inverse_dynamics(self._arm, q, qd, qdd)
        laden = inverse_dynamics(self._carrying, q, qd, qdd)
        return np.asarray(bare + self.mass_kg / _PROBE_KG * (laden - bare))

    def delta(self, time_s: float, q: Array) -> Array:
        """Learn from the error, then feed forward."""
        assert self._reference is not None
        step = HOST_MS * 1e-3
        wanted, rate, push = self._reference.at(time_s - self._late_s)
        error = wanted - q
        slope = np.zeros_like(error) if self._last is None else (error - self._last) / step
        self._last = error
        per_kg = payload_regressor(self._arm, wanted, rate, push)
        s = slope + self._lambda * error
        if np.abs(error).max() < TEACHING_RAD:
            self.mass_kg += self._gamma * step * float(per_kg @ s)
            self.mass_kg = min(max(self.mass_kg, 0.0), MOST_KG)
        out = super().delta(time_s, q)
        if time_s < 0.0:
            out = out - self._integral
            self._integral = np.zeros_like(self._integral)
        return np.asarray(out)
