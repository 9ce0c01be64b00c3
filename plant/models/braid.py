"""Models derived from the braid: Chou and Hannaford, Hasselroth, Tondu and Lopez.

In all four, the force is p times a quadratic in length; they differ in the parameters of that
quadratic. A fit to forces alone determines only the quadratic, so not all parameters of a model can
be free: see each docstring.
"""

from __future__ import annotations

import numpy as np

from plant.arrays import Array
from plant.models.law import Law, Past, SeparableLaw, Slopes

BAR_PA = 1e5


class ChouHannaford(SeparableLaw):
    """Equations 4-4 to 4-8: F = p (3 L^2 - b^2) / (4 pi n^2), V = (b^2 L - L^3) / (4 pi n^2).

    Valid for an inextensible braid with a cylindrical middle part, 0 < L < b.
    """

    parameters = ("braid_length", "turns")

    def arm(self, q: Array, length: Array) -> Array:
        """(3 L^2 - b^2) / (4 pi n^2)."""
        b, n = q
        return np.asarray((3.0 * length * length - b * b) / (4.0 * np.pi * n * n))

    def arm_slope(self, q: Array, length: Array) -> Array:
        """6 L / (4 pi n^2)."""
        return np.asarray(length * (6.0 / (4.0 * np.pi * q[1] ** 2)))

    def swept(self, q: Array, length: Array) -> Array:
        """Equation 4-6."""
        b, n = q
        return np.asarray((b * b - length * length) * length / (4.0 * np.pi * n * n))

    def jacobian(self, q: Array, p: Array, length: Array, t: Array, path: Past = None) -> Array:
        """With respect to b and n."""
        b, n = q
        by_b = p * (-2.0 * b / (4.0 * np.pi * n * n))
        return np.stack([by_b, p * self.arm(q, length) * (-2.0 / n)])


class Hasselroth(SeparableLaw):
    """Equation 4-19: F = p D^2 a ((1 - eps)^2 - b), eps = 1 - L / L_0, valid for 0 < eps < 0.2.

    Forces alone determine two numbers, D^2 a / L_0^2 and b L_0^2: measure D and L_0.
    """

    parameters = ("diameter", "gain", "offset", "rest_length")

    def arm(self, q: Array, length: Array) -> Array:
        """D^2 a ((L / L_0)^2 - b)."""
        d, a, b, rest = q
        return np.asarray(d * d * a * (length * length / (rest * rest) - b))

    def arm_slope(self, q: Array, length: Array) -> Array:
        """2 D^2 a L / L_0^2."""
        d, a, _, rest = q
        return np.asarray(length * (2.0 * d * d * a / (rest * rest)))

    def swept(self, q: Array, length: Array) -> Array:
        """-D^2 a (L^3 / (3 L_0^2) - b L)."""
        d, a, b, rest = q
        return np.asarray(
            -d * d * a * (length * length * length / (3.0 * rest * rest) - b * length)
        )

    def jacobian(self, q: Array, p: Array, length: Array, t: Array, path: Past = None) -> Array:
        """With respect to D, a, b and L_0."""
        d, a, _, rest = q
        force = p * self.arm(q, length)
        by_rest = p * length * length * (-2.0 * d * d * a / rest**3)
        return np.stack([force * (2.0 / d), force / a, p * (-d * d * a), by_rest])


class TonduLopez(SeparableLaw):
    """Tondu and Lopez (2000): F = pi r0^2 p (a (1 - k eps)^2 - c), a = 3/tan^2, c = 1/sin^2 of
    the braid angle theta0 at L_0, eps = 1 - L / L_0.

    k >= 1 corrects for the tapered ends. Forces alone determine three numbers, so r0, theta0, L_0
    and k cannot all be free.
    """

    parameters = ("radius", "braid_angle", "rest_length", "end_factor")

    def arm(self, q: Array, length: Array) -> Array:
        """Pi r0^2 (a (1 - k eps)^2 - c)."""
        r, angle, rest, k = q
        a, c = 3.0 / np.tan(angle) ** 2, 1.0 / np.sin(angle) ** 2
        u = (1.0 - k) + length * (k / rest)
        return np.asarray(np.pi * r * r * (a * u * u - c))

    def arm_slope(self, q: Array, length: Array) -> Array:
        """2 pi r0^2 a u k / L_0."""
        r, angle, rest, k = q
        u = (1.0 - k) + length * (k / rest)
        return np.asarray(u * (2.0 * np.pi * r * r * 3.0 / np.tan(angle) ** 2 * k / rest))

    def swept(self, q: Array, length: Array) -> Array:
        """-pi r0^2 (a L_0 u^3 / (3 k) - c L)."""
        r, angle, rest, k = q
        a, c = 3.0 / np.tan(angle) ** 2, 1.0 / np.sin(angle) ** 2
        u = (1.0 - k) + length * (k / rest)
        return np.asarray(-np.pi * r * r * (a * rest / (3.0 * k) * u * u * u - c * length))

    def jacobian(self, q: Array, p: Array, length: Array, t: Array, path: Past = None) -> Array:
        """With respect to r0, theta0, L_0 and k."""
        return _tondu_sensitivity(q[0], q[1], q[2], np.full_like(length, q[3]), p, length)


class TonduLopezPressure(Law):
    """Tondu and Lopez with k(P) = a_k exp(-P) + b_k, P in bar: the ends
    fill as the pressure rises.
    """

    parameters = ("radius", "braid_angle", "rest_length", "end_decay", "end_limit")

    def _k(self, q: Array, p: Array) -> tuple[Array, Array]:
        decay = np.exp(p * (-1.0 / BAR_PA))
        return decay, q[3] * decay + q[4]

    def force(self, q: Array, p: Array, length: Array, t: Array, path: Past = None) -> Array:
        """Pi r0^2 p (a (1 - k(P) eps)^2 - c)."""
        r, angle, rest = q[:3]
        a, c = 3.0 / np.tan(angle) ** 2, 1.0 / np.sin(angle) ** 2
        _, k = self._k(q, p)
        u = 1.0 - k * (1.0 - length / rest)
        return np.asarray(np.pi * r * r * p * (a * u * u - c))

    def slopes(self, q: Array, p: Array, length: Array, t: Array, path: Past = None) -> Slopes:
        """With respect to p (also through k) and L."""
        r, angle, rest = q[:3]
        a, c = 3.0 / np.tan(angle) ** 2, 1.0 / np.sin(angle) ** 2
        decay, k = self._k(q, p)
        contraction = 1.0 - length / rest
        u = 1.0 - k * contraction
        area = np.pi * r * r
        by_k = area * p * 2.0 * a * u * -contraction
        by_p = area * (a * u * u - c) + by_k * q[3] * decay * (-1.0 / BAR_PA)
        return by_p, area * p * 2.0 * a * u * k / rest, np.zeros_like(length)

    def jacobian(self, q: Array, p: Array, length: Array, t: Array, path: Past = None) -> Array:
        """With respect to r0, theta0, L_0, a_k and b_k."""
        decay, k = self._k(q, p)
        rows = _tondu_sensitivity(q[0], q[1], q[2], k, p, length)
        return np.stack([rows[0], rows[1], rows[2], rows[3] * decay, rows[3]])


def _tondu_sensitivity(
    r: float, angle: float, rest: float, k: Array, p: Array, length: Array
) -> Array:
    """Derivatives of F with respect to r0, theta0, L_0 and k, shape (4, n)."""
    sine, cosine = np.sin(angle), np.cos(angle)
    a, c = 3.0 * cosine**2 / sine**2, 1.0 / sine**2
    contraction = 1.0 - length / rest
    u = 1.0 - k * contraction
    gas = np.pi * r * r * p
    by_angle = gas * (u * u * (-6.0 * cosine / sine**3) + 2.0 * cosine / sine**3)
    by_rest = gas * 2.0 * a * u * (-k * length / (rest * rest))
    by_k = gas * 2.0 * a * u * -contraction
    return np.stack([gas * (a * u * u - c) * (2.0 / r), by_angle, by_rest, by_k])
