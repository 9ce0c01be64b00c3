"""Models with rubber parts: Sarosi's exponentials, industrial fluidic muscles, bladder, liner."""

from __future__ import annotations

import numpy as np

from plant.arrays import Array
from plant.models.braid import ChouHannaford, TonduLopez
from plant.models.law import Law, Past, SeparableLaw, Slopes

_BRAID = ChouHannaford()
_TAPERED = TonduLopez()


class Sarosi(SeparableLaw):
    """Sarosi (2012): F = (p1 P + p2) exp(p3 k) + p4 P k + p5 P + p6, P in bar, k in percent.

    Empirical; k = 1 - L / L_0. Accurate within its data and inaccurate outside: published
    transfers to other muscles have errors of 132 to 178 N rms.
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
        """With respect to L: the derivative by k, times -1/L_0."""
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
        """With respect to L."""
        return np.asarray(self._exp(q, length)[1] * (-q[1] * q[2] / q[6]))

    def force(self, q: Array, p: Array, length: Array, t: Array, path: Past = None) -> Array:
        """Both parts, with one exponential."""
        k, e = self._exp(q, length)
        return np.asarray((p * q[0] + q[1]) * e + p * (q[3] * k + q[4]) + q[5])

    def jacobian(self, q: Array, p: Array, length: Array, t: Array, path: Past = None) -> Array:
        """With respect to p1 to p6 and L_0."""
        k, e = self._exp(q, length)
        lead = (p * q[0] + q[1]) * e
        by_k = lead * q[2] + p * q[3]
        by_rest = by_k * length / (q[6] * q[6])
        return np.stack([p * e, e, lead * k, p * k, p, np.ones_like(p), by_rest])


_SAROSI = Sarosi()
LEAD_N_PER_PA = 1e-5
"""1 N/bar: the factor of the pressure in front of the exponential of `SarosiFive`."""


class SarosiFive(SeparableLaw):
    """Sarosi's form with five constants: F = (p + a1) exp(a2 k) + a3 k p + a4 p + a5.

    F in N, p in bar gauge, k = 100 (1 - L / L_0) in percent. The lead of the exponential is 1 N/bar
    by definition, so the numbers hold in these units only; `Sarosi` has it as a parameter. The
    exponential is the membrane near the rest length, a5 the force that must be overcome before
    the muscle pulls. J. Sarosi, "New approximation algorithm for the force of fluidic muscles",
    SACI 2012, and later papers. Empirical: not for other muscles, not outside the data.
    """

    parameters = ("a1", "a2", "a3", "a4", "a5", "rest_length")

    @staticmethod
    def _six(q: Array) -> Array:
        """Parameters of the form with six constants."""
        a1, a2, a3, a4, a5, rest = q
        return np.array([LEAD_N_PER_PA, a1, a2, a3, a4, a5, rest])

    def arm(self, q: Array, length: Array) -> Array:
        """exp(a2 k) + a3 k + a4."""
        return _SAROSI.arm(self._six(q), length)

    def arm_slope(self, q: Array, length: Array) -> Array:
        """With respect to L."""
        return _SAROSI.arm_slope(self._six(q), length)

    def swept(self, q: Array, length: Array) -> Array:
        """Minus the integral of `arm`."""
        return _SAROSI.swept(self._six(q), length)

    def passive(self, q: Array, length: Array) -> Array:
        """a1 exp(a2 k) + a5."""
        return _SAROSI.passive(self._six(q), length)

    def passive_slope(self, q: Array, length: Array) -> Array:
        """With respect to L."""
        return _SAROSI.passive_slope(self._six(q), length)

    def force(self, q: Array, p: Array, length: Array, t: Array, path: Past = None) -> Array:
        """Both parts, with one exponential."""
        return _SAROSI.force(self._six(q), p, length, t)

    def jacobian(self, q: Array, p: Array, length: Array, t: Array, path: Past = None) -> Array:
        """With respect to a1 to a5 and L_0."""
        return _SAROSI.jacobian(self._six(q), p, length, t)[1:]


class Fluidic(SeparableLaw):
    """An industrial fluidic muscle: braid with tapered ends, elastic membrane, and an offset.

    F = pi r0^2 p (a (1 - k eps)^2 - c) + F_e exp(-eps / eps_e) - F_0, a = 3/tan^2(theta0),
    c = 1/sin^2(theta0), eps = 1 - L / L_0. The first term is Chou and Hannaford (1996) written in
    the rest geometry, with the end factor k of Tondu and Lopez (2000). The fibres of a fluidic
    muscle lie in its membrane: near the rest length the membrane pulls (F_e, fading with eps_e),
    and the pressure must first overcome F_0. Beyond the rest length, x = eps / eps_e < 0, the
    exponential goes on as 1 - x + x^2 / 2, which has its value, slope and curvature at x = 0: no
    measured point is far out there, and an exponential would soon be without bound.

    r0 and theta0 are constants of the force. They are not the dimensions of the muscle and give
    no gas volume: see `plant.models.model.Geometry`.
    """

    parameters = (
        "radius", "braid_angle", "rest_length", "end_factor", "elastic_force", "elastic_strain",
        "offset_force",
    )  # fmt: skip

    def _elastic(self, q: Array, length: Array) -> tuple[Array, Array, Array]:
        """Contraction x = eps / eps_e, fading factor of the membrane, minus its derivative."""
        x = (1.0 - length / q[2]) * (1.0 / q[5])
        fading = np.exp(-np.maximum(x, 0.0))
        beyond = np.minimum(x, 0.0)
        slope = fading - beyond
        return x, slope + 0.5 * beyond * beyond, slope

    def arm(self, q: Array, length: Array) -> Array:
        """That of the braid with tapered ends."""
        return _TAPERED.arm(q[:4], length)

    def arm_slope(self, q: Array, length: Array) -> Array:
        """That of the braid with tapered ends."""
        return _TAPERED.arm_slope(q[:4], length)

    def swept(self, q: Array, length: Array) -> Array:
        """That of the braid with tapered ends."""
        return _TAPERED.swept(q[:4], length)

    def passive(self, q: Array, length: Array) -> Array:
        """F_e exp(-eps / eps_e) - F_0."""
        return np.asarray(q[4] * self._elastic(q, length)[1] - q[6])

    def passive_slope(self, q: Array, length: Array) -> Array:
        """With respect to L."""
        return np.asarray(self._elastic(q, length)[2] * (q[4] / (q[5] * q[2])))

    def jacobian(self, q: Array, p: Array, length: Array, t: Array, path: Past = None) -> Array:
        """With respect to all seven parameters."""
        rows = _TAPERED.jacobian(q[:4], p, length, t)
        x, fading, slope = self._elastic(q, length)
        by_rest = slope * (-q[4] / q[5]) * length / (q[2] * q[2])
        elastic = [fading, slope * x * (q[4] / q[5]), -np.ones_like(length)]
        return np.concatenate([rows[:2], [rows[2] + by_rest], rows[3:], elastic])


class BraidBladder(SeparableLaw):
    """Chou and Hannaford with a bladder spring: F = F_braid + k (L - L_r).

    The linear form of the bladder terms of Klute and Hannaford (2000) and later papers: a rubber
    tube with rest length L_r and spring rate k, independent of pressure.
    """

    parameters = ("braid_length", "turns", "stiffness", "bladder_rest_length")

    def arm(self, q: Array, length: Array) -> Array:
        """That of the braid."""
        return _BRAID.arm(q[:2], length)

    def arm_slope(self, q: Array, length: Array) -> Array:
        """That of the braid."""
        return _BRAID.arm_slope(q[:2], length)

    def swept(self, q: Array, length: Array) -> Array:
        """That of the braid."""
        return _BRAID.swept(q[:2], length)

    def passive(self, q: Array, length: Array) -> Array:
        """Spring force k (L - L_r)."""
        return np.asarray(q[2] * (length - q[3]))

    def passive_slope(self, q: Array, length: Array) -> Array:
        """Spring rate k."""
        return np.full_like(length, q[2])

    def jacobian(self, q: Array, p: Array, length: Array, t: Array, path: Past = None) -> Array:
        """With respect to b, n, k and L_r."""
        braid = _BRAID.jacobian(q[:2], p, length, t)
        return np.concatenate([braid, [length - q[3], np.full_like(length, -q[2])]])


class LinerBraid(Law):
    """Braid, bladder spring, and a liner that must expand before it touches the braid.

    F = p_eff (3 L^2 - b^2) / (4 pi n^2) + k (L - L_r), where p_eff = w ln(1 + e^((p - p_t)/w) -
    e^(-p_t/w)) is the dead band of `plant.physics.muscle.liner_pressure`, and p_t(L) = p_0 + p_1
    (L - L_ref), at least 0. A shorter muscle has a wider braid, so its liner must expand further:
    expect p_1 < 0. Smooth in pressure and length, unlike the piecewise models.
    """

    parameters = (
        "braid_length", "turns", "stiffness", "bladder_rest_length", "threshold", "threshold_slope",
        "width", "reference_length",
    )  # fmt: skip

    def _exponents(self, q: Array, p: Array, length: Array) -> tuple[Array, Array, Array, Array]:
        """(p - p_t)/w = u, -p_t/w = u0, ln(1 - e^u0 + e^u), and whether p_t is above 0."""
        w = q[6]
        raw = q[4] + q[5] * (length - q[7])
        active = raw > 1e-9 * w
        u0 = np.where(active, raw, 1e-9 * w) * (-1.0 / w)
        u = p / w + u0
        logs = np.maximum(u, 0.0)  # avoids overflow of e^u
        logs += np.log(np.exp(u - logs) - np.expm1(u0) * np.exp(-logs))
        return u, u0, logs, active

    def _liner(self, q: Array, p: Array, length: Array) -> tuple[Array, Array, Array, Array, Array]:
        """p_eff, its derivatives by p and p_t, u sigma - u0 rho, and whether p_t is above 0."""
        u, u0, logs, active = self._exponents(q, p, length)
        sigma, rho = np.exp(u - logs), np.exp(u0 - logs)
        return q[6] * logs, sigma, rho - sigma, u * sigma - u0 * rho, active

    def force(self, q: Array, p: Array, length: Array, t: Array, path: Past = None) -> Array:
        """Braid at p_eff, and spring."""
        logs = self._exponents(q, p, length)[2]
        return np.asarray(q[6] * logs * _BRAID.arm(q[:2], length) + q[2] * (length - q[3]))

    def slopes(self, q: Array, p: Array, length: Array, t: Array, path: Past = None) -> Slopes:
        """With respect to p and L, also through the threshold."""
        effective, by_p, by_t, _, active = self._liner(q, p, length)
        arm = _BRAID.arm(q[:2], length)
        by_l = effective * _BRAID.arm_slope(q[:2], length) + q[2] + arm * by_t * q[5] * active
        return by_p * arm, by_l, np.zeros_like(length)

    def jacobian(self, q: Array, p: Array, length: Array, t: Array, path: Past = None) -> Array:
        """With respect to all eight parameters."""
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
