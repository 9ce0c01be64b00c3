"""Models with rubber in them: Sarosi's exponential, a bladder spring, a liner threshold."""

from __future__ import annotations

import numpy as np

from plant.models.braid import ChouHannaford
from plant.models.law import Array, History, Law, SeparableLaw, Slopes

_BRAID = ChouHannaford()


class Sarosi(SeparableLaw):
    """Sarosi (2012): F = (p1 P + p2) exp(p3 k) + p4 P k + p5 P + p6, P in bar, k in percent.

    Empirical; k = 1 - L / L_0. Good inside the data it was fitted to and poor outside: published
    transfers to other muscles err by 132 to 178 N rms.
    """

    parameters = ("p1", "p2", "p3", "p4", "p5", "p6", "rest_length")

    def _exp(self, q: Array, length: Array) -> tuple[Array, Array]:
        k = 1.0 - length / q[6]
        return k, np.exp(q[2] * k)

    def arm(self, q: Array, length: Array) -> Array:
        """p1 exp(p3 k) + p4 k + p5."""
        k, e = self._exp(q, length)
        return np.asarray(q[0] * e + q[3] * k + q[4])

    def arm_slope(self, q: Array, length: Array) -> Array:
        """By L: -1/L_0 of the derivative by k."""
        _, e = self._exp(q, length)
        return np.asarray((q[0] * q[2] * e + q[3]) * (-1.0 / q[6]))

    def swept(self, q: Array, length: Array) -> Array:
        """Minus the integral; dL = -L_0 dk."""
        k, e = self._exp(q, length)
        return np.asarray(q[6] * (q[0] / q[2] * e + q[3] * k * k / 2.0 + q[4] * k))

    def passive(self, q: Array, length: Array) -> Array:
        """p2 exp(p3 k) + p6."""
        return np.asarray(q[1] * self._exp(q, length)[1] + q[5])

    def passive_slope(self, q: Array, length: Array) -> Array:
        """By L."""
        return np.asarray(self._exp(q, length)[1] * (-q[1] * q[2] / q[6]))

    def force(
        self, q: Array, p: Array, length: Array, t: Array, path: History | None = None
    ) -> Array:
        """Both parts, with one exponential."""
        k, e = self._exp(q, length)
        return np.asarray((p * q[0] + q[1]) * e + p * (q[3] * k + q[4]) + q[5])

    def jacobian(
        self, q: Array, p: Array, length: Array, t: Array, path: History | None = None
    ) -> Array:
        """By p1 to p6 and L_0."""
        k, e = self._exp(q, length)
        lead = (p * q[0] + q[1]) * e
        by_k = lead * q[2] + p * q[3]
        by_rest = by_k * length / (q[6] * q[6])
        return np.stack([p * e, e, lead * k, p * k, p, np.ones_like(p), by_rest])


class BraidBladder(SeparableLaw):
    """Chou and Hannaford and a bladder that is a spring: F = F_braid + k (L - L_r).

    The straight-line form of the bladder terms of Klute and Hannaford (2000) and later work: a
    rubber tube at rest at L_r, with spring rate k whatever the pressure.
    """

    parameters = ("braid_length", "turns", "stiffness", "bladder_rest_length")

    def arm(self, q: Array, length: Array) -> Array:
        """Of the braid."""
        return _BRAID.arm(q[:2], length)

    def arm_slope(self, q: Array, length: Array) -> Array:
        """Of the braid."""
        return _BRAID.arm_slope(q[:2], length)

    def swept(self, q: Array, length: Array) -> Array:
        """Of the braid."""
        return _BRAID.swept(q[:2], length)

    def passive(self, q: Array, length: Array) -> Array:
        """K (L - L_r)."""
        return np.asarray(q[2] * (length - q[3]))

    def passive_slope(self, q: Array, length: Array) -> Array:
        """K."""
        return np.full_like(length, q[2])

    def jacobian(
        self, q: Array, p: Array, length: Array, t: Array, path: History | None = None
    ) -> Array:
        """By b, n, k and L_r."""
        braid = _BRAID.jacobian(q[:2], p, length, t)
        return np.concatenate([braid, [length - q[3], np.full_like(length, -q[2])]])


class LinerBraid(Law):
    """Braid, bladder spring, and a liner that must swell before it meets the braid.

    F = p_eff (3 L^2 - b^2) / (4 pi n^2) + k (L - L_r), where p_eff = w ln(1 + e^((p - p_t)/w) -
    e^(-p_t/w)) is the dead band of `plant.physics.muscle.liner_pressure`, and p_t(L) = p_0 + p_1
    (L - L_ref) (never below 0): the shorter the muscle, the wider its braid and the further the
    liner must swell, so p_1 < 0 is expected. Smooth in pressure and length, unlike the piecewise
    ones.
    """

    parameters = (
        "braid_length",
        "turns",
        "stiffness",
        "bladder_rest_length",
        "threshold",
        "threshold_slope",
        "width",
        "reference_length",
    )

    def _liner(self, q: Array, p: Array, length: Array) -> tuple[Array, Array, Array, Array, Array]:
        """p_eff, d p_eff by p and by p_t, u sigma - u0 rho, and where the threshold is above 0."""
        w = q[6]
        raw = q[4] + q[5] * (length - q[7])
        active = raw > 1e-9 * w
        u0 = np.where(active, raw, 1e-9 * w) * (-1.0 / w)
        u = p / w + u0
        # log(1 - e^u0 + e^u) without overflow.
        logs = np.maximum(u, 0.0)
        logs += np.log(np.exp(u - logs) - np.expm1(u0) * np.exp(-logs))
        sigma, rho = np.exp(u - logs), np.exp(u0 - logs)
        return w * logs, sigma, rho - sigma, u * sigma - u0 * rho, active

    def force(
        self, q: Array, p: Array, length: Array, t: Array, path: History | None = None
    ) -> Array:
        """Braid under p_eff, and spring."""
        w = q[6]
        u0 = np.maximum(q[4] + q[5] * (length - q[7]), 1e-9 * w) * (-1.0 / w)
        u = p / w + u0
        logs = np.maximum(u, 0.0)
        logs += np.log(np.exp(u - logs) - np.expm1(u0) * np.exp(-logs))
        return np.asarray(w * logs * _BRAID.arm(q[:2], length) + q[2] * (length - q[3]))

    def slopes(
        self, q: Array, p: Array, length: Array, t: Array, path: History | None = None
    ) -> Slopes:
        """By p and L, through the threshold too."""
        effective, by_p, by_t, _, active = self._liner(q, p, length)
        arm = _BRAID.arm(q[:2], length)
        by_l = effective * _BRAID.arm_slope(q[:2], length) + q[2] + arm * by_t * q[5] * active
        return by_p * arm, by_l, np.zeros_like(length)

    def jacobian(
        self, q: Array, p: Array, length: Array, t: Array, path: History | None = None
    ) -> Array:
        """By all eight."""
        effective, _, by_t, mixed, active = self._liner(q, p, length)
        arm = _BRAID.arm(q[:2], length)
        braid = _BRAID.jacobian(q[:2], effective, length, t)
        threshold = arm * by_t * active
        by_w = arm * (effective / q[6] - mixed)
        rows = [
            length - q[3],
            np.full_like(length, -q[2]),
            threshold,
            threshold * (length - q[7]),
            by_w,
        ]
        return np.concatenate([braid, rows, [threshold * -q[5]]])
