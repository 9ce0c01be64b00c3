"""Adaptive law: payload and friction are estimated from the motion and used in the feed-forward.

This is the desired compensation adaptation law (Sadegh and Horowitz 1990, Int. J. Robotics Research
9(3)). It is the form of the adaptive manipulator control of Slotine and Li (1987, ibid. 6(3)) whose
regressor uses the reference motion, so that it has no noise:

    torque = Y0(q_d, q_d', q_d'') + m Y(q_d, q_d', q_d'') + f_j W_j(q_d) + bias
    dm/dt  = gamma Y^T s,   df_j/dt = gamma_j W_j s_j,   s = e' + lambda e,   e = q_d - q

Y is the torque per kilogram at the tip, exact, from the link equations. W_j is the torque per
newton of friction in the braids of joint j (`fibres`). m is limited to 0 to 100 g, f to 0 to 20 N.
The feedback of the published law is replaced by stiffness and damping of the muscles. `bias` is the
slow integral of `feedforward`, at a quarter of its rate, for all other errors. It starts at time 0:
the payload is estimated during the approach, otherwise both would share one static error
permanently. Friction is also estimated from time 0, because before that the reference does not
move. With errors above 10 degrees nothing is estimated: the finger is falling or at a stop.

The rates gamma follow from a constant error: if it were caused by the payload only (or by friction
only, with all fibres slipping) at the posture of the model, m (or f) would converge at half of the
integral rate of `feedforward`. lambda is twice the frequency of the slowest oscillation, so that s
does not feed back the oscillation through e'.
"""

from __future__ import annotations

import numpy as np

from plant.arrays import Array
from plant.links import Arm
from plant.links.dynamics import inverse_dynamics
from plant.physics.friction import REFERENCE_PRESSURE_PA
from studies.controllers.feedforward import FeedForward
from studies.controllers.fibres import Fibres
from studies.controllers.loop import HOST_MS
from studies.controllers.model import Linear
from studies.controllers.muscles import MEAN_KPA, Pairs
from studies.controllers.reference import Reference

MOST_KG = 0.1
MOST_N = 20.0
BIAS_SHARE = 0.25
LEARNING_SHARE = 0.5
TEACHING_RAD = np.radians(10.0)
_PROBE_KG = 0.1


def payload_regressor(arm: Arm, q: Array, qd: Array, qdd: Array) -> Array:
    """Torque (n,) per kilogram at the tip in a motion, N m/kg; exact, as it is linear in mass."""
    with_it = inverse_dynamics(arm.with_payload(_PROBE_KG), q, qd, qdd)
    return (with_it - inverse_dynamics(arm, q, qd, qdd)) / _PROBE_KG


class Adaptive(FeedForward):
    """Feed-forward with estimates of payload (kg) and friction of each joint (N at 300 kPa)."""

    def __init__(
        self, pairs: Pairs, model: Linear, lead_s: float, rate: float, late_s: float = 0.002
    ) -> None:
        super().__init__(pairs, model, lead_s, BIAS_SHARE * rate, late_s)
        self.mass_kg = 0.0
        self.friction_n = np.zeros(model.degrees)
        self._arm = pairs.finger.arm
        self._carrying = self._arm.with_payload(_PROBE_KG)
        still = np.zeros(model.degrees)
        weight = payload_regressor(self._arm, model.q0, still, still)
        self._lambda = 2.0 * 2.0 * np.pi / model.slowest_period_s
        # A torque y deflects the joints by K^-1 y. With s = e' + lambda e the rate of convergence
        # is gamma lambda y^T K^-1 y.
        gained = float(weight @ np.linalg.solve(model.stiffness, weight))
        self._gamma = LEARNING_SHARE * rate / (self._lambda * gained)
        slipping = pairs.radius * 2.0 * MEAN_KPA * 1e3 / REFERENCE_PRESSURE_PA
        softness = np.diag(np.linalg.inv(model.stiffness))
        self._gamma_friction = LEARNING_SHARE * rate / (self._lambda * slipping**2 * softness)
        # Fibres at the time of the commands, and at the time of the measured angles.
        self._sent, self._seen = Fibres(pairs), Fibres(pairs)
        self._last: Array | None = None

    @property
    def estimates(self) -> Array:
        """Estimated payload, kg, then friction of each joint, N."""
        return np.array([self.mass_kg, *self.friction_n])

    def start(self, reference: Reference, q: Array) -> None:
        """Reset all states, including payload and friction."""
        super().start(reference, q)
        self.mass_kg = 0.0
        self.friction_n = np.zeros_like(self.friction_n)
        self._sent.start()
        self._seen.start()
        self._last = None

    def torque(self, q: Array, qd: Array, qdd: Array) -> Array:
        """Nominal torque with the estimated payload and friction."""
        smooth = self._smooth(q, qd, qdd)
        return np.asarray(smooth + self.friction_n * self._per_newton(self._sent, q, smooth))

    def _smooth(self, q: Array, qd: Array, qdd: Array) -> Array:
        bare = inverse_dynamics(self._arm, q, qd, qdd)
        laden = inverse_dynamics(self._carrying, q, qd, qdd)
        return np.asarray(bare + self.mass_kg / _PROBE_KG * (laden - bare))

    def _per_newton(self, fibres: Fibres, q: Array, torque: Array) -> Array:
        """Torque per newton of friction at a point of the motion, with its pressures."""
        return fibres.torque(q, self.pairs.pressures(self.pairs.delta(q, torque)))

    def delta(self, time_s: float, q: Array) -> Array:
        """Update the estimates, then feed forward."""
        assert self._reference is not None
        step = HOST_MS * 1e-3
        wanted, rate, acceleration = self._reference.at(time_s - self._late_s)
        error = wanted - q
        slope = np.zeros_like(error) if self._last is None else (error - self._last) / step
        self._last = error
        per_kg = payload_regressor(self._arm, wanted, rate, acceleration)
        per_newton = self._per_newton(self._seen, wanted, self._smooth(wanted, rate, acceleration))
        s = slope + self._lambda * error
        if np.abs(error).max() < TEACHING_RAD:
            self.mass_kg += self._gamma * step * float(per_kg @ s)
            self.mass_kg = min(max(self.mass_kg, 0.0), MOST_KG)
            if time_s >= 0.0:
                friction = self.friction_n + self._gamma_friction * step * per_newton * s
                self.friction_n = np.clip(friction, 0.0, MOST_N)
        out = super().delta(time_s, q)
        if time_s < 0.0:
            out = out - self._integral
            self._integral = np.zeros_like(self._integral)
        return np.asarray(out)
