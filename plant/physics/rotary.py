"""The rotary muscle of chapter 3: volume and torque of a braided sleeve that twists and bulges.

A cylinder of radius h and length k carries fibres of length f from end to end. Turned by theta, a
fibre spans the arc h theta round the cylinder, so that the sleeve's profile has the length

    l = sqrt(f^2 - h^2 theta^2)                                  (3-4 to 3-6)

and bulges as an arc of a circle over the chord k. With alpha half the angle of that arc,
l / k = alpha / sin(alpha), its radius is R = k / (2 sin(alpha)), and the volume beyond the cylinder

    V = pi (k R^2 - k^3/12 - (R l + k h) sqrt(R^2 - k^2/4) + R l h)

as the thesis has it. Its last steps are wrong: it prints l = sqrt(h^2 theta^2 - f^2), which has no
real value for any sleeve longer than its cylinder, and dl/dtheta = h^2 theta / sqrt(h^2 theta^2 +
f^2), of the wrong sign and size. Right is dl/dtheta = -h^2 theta / l, and with it

    dV/dl = pi (k h / sin(alpha)
                + k^2 (alpha (1 + 2 cos^2) - 3 sin cos) / (4 sin^2 (sin - alpha cos)))

which equals the thesis's own dV/dl but does not lose its digits where the bulge is flat.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from plant.arrays import Array
from plant.errors import PlantError

_SERIES_BELOW = 1.0
_TERMS = 16


@dataclass(frozen=True)
class RotaryMuscle:
    """A rotary muscle; lengths in m.

    Attributes:
        radius_m: h, of the cylinder.
        length_m: k, of the cylinder between the ends of the sleeve.
        fibre_m: f, of a fibre; longer than the cylinder.
    """

    radius_m: float
    length_m: float
    fibre_m: float

    def __post_init__(self) -> None:
        for name in ("radius_m", "length_m", "fibre_m"):
            if not getattr(self, name) > 0:
                raise PlantError(f"rotary muscle: {name} = {getattr(self, name)!r}; must be > 0")
        if not self.fibre_m > self.length_m:
            raise PlantError(
                f"rotary muscle: fibre_m = {self.fibre_m:g} is not longer than length_m = "
                f"{self.length_m:g}: such a sleeve cannot bulge"
            )

    @property
    def range_rad(self) -> tuple[float, float]:
        """Least and largest |theta| at which the geometry exists, the largest not included.

        At the largest the sleeve lies flat on the cylinder; below the least (0 for fibres shorter
        than pi k / 2) the profile would be more than a semicircle, not a function of x any more.
        """
        k, f = self.length_m, self.fibre_m
        flat = math.sqrt(f * f - k * k) / self.radius_m
        half = math.pi * k / 2
        round_ = math.sqrt(f * f - half * half) / self.radius_m if f > half else 0.0
        return round_, flat

    def profile_length(self, theta_rad: npt.ArrayLike) -> Array:
        """L in m. Raises `PlantError` outside `range_rad`."""
        theta = self._checked(theta_rad)
        return np.asarray(np.sqrt(self.fibre_m**2 - (self.radius_m * theta) ** 2))

    def profile_length_slope(self, theta_rad: npt.ArrayLike) -> Array:
        """dl/dtheta = -h^2 theta / l in m/rad. Raises `PlantError` outside `range_rad`."""
        theta = self._checked(theta_rad)
        return np.asarray(-(self.radius_m**2) * theta / self.profile_length(theta))

    def arc(self, theta_rad: npt.ArrayLike) -> tuple[Array, Array]:
        """(half angle alpha in rad, radius R in m). Raises `PlantError` outside `range_rad`."""
        theta = self._checked(theta_rad)
        k = self.length_m
        # l^2/k^2 - 1 without losing digits where the sleeve is nearly flat.
        flat = self.range_rad[1]
        excess = self.radius_m**2 * (flat - theta) * (flat + theta) / k**2
        alpha = _half_angle(np.asarray(excess, dtype=np.float64))
        return alpha, np.asarray(k / (2.0 * np.sin(alpha)))

    def bulge_volume(self, theta_rad: npt.ArrayLike) -> Array:
        """Volume in m3 between sleeve and cylinder. Raises `PlantError` outside `range_rad`."""
        alpha, _ = self.arc(theta_rad)
        h, k = self.radius_m, self.length_m
        s = np.sin(alpha)
        round_part, flat_part = _bulge(alpha)
        return np.asarray(
            math.pi * (k**3 * round_part / (12.0 * s**3) + 0.5 * k * k * h * flat_part / (s * s))
        )

    def dvolume_dtheta(self, theta_rad: npt.ArrayLike) -> Array:
        """dV/dtheta in m3/rad, in closed form. Raises `PlantError` outside `range_rad`."""
        alpha, _ = self.arc(theta_rad)
        h, k = self.radius_m, self.length_m
        s = np.sin(alpha)
        by_length = math.pi * (k * h / s + k * k * _round_slope(alpha))
        return np.asarray(by_length * self.profile_length_slope(theta_rad))

    def torque_n_m(self, pressure_pa: npt.ArrayLike, theta_rad: npt.ArrayLike) -> Array:
        """-p dV/dtheta (3-3): positive turns towards larger theta against nothing else.

        Both ends' torque for gauge pressure in Pa. Raises `PlantError` outside `range_rad`.
        """
        p = np.asarray(pressure_pa, dtype=np.float64)
        return np.asarray(-p * self.dvolume_dtheta(theta_rad))

    def printed_dvolume_dtheta(self, theta_rad: npt.ArrayLike) -> Array:
        """What the thesis's last equation gives, with the right l and R put in.

        With its own l there is no real number at all. For comparison only.
        """
        theta = self._checked(theta_rad)
        h, k, f = self.radius_m, self.length_m, self.fibre_m
        _, r = self.arc(theta)
        length = self.profile_length(theta)
        root = np.sqrt(np.maximum(r * r - k * k / 4.0, 0.0))
        curly = 3 * k * r * root + 2 * length * h * root - 3 * length * r * r
        curly = curly + length * k * k / 2 - 2 * k * h * r
        turned = h * h * theta / np.sqrt(h * h * theta * theta + f * f)
        return np.asarray(math.pi * r * turned / (length * root - k * r) * curly)

    def _checked(self, theta_rad: npt.ArrayLike) -> Array:
        theta = np.asarray(theta_rad, dtype=np.float64)
        least, largest = self.range_rad
        bad = ~((np.abs(theta) >= least) & (np.abs(theta) < largest))
        if np.any(bad):
            at = float(theta[bad].flat[0])
            why = (
                "the profile would be more than a semicircle" if abs(at) < least
                else "the fibres cannot reach round the cylinder"
            )  # fmt: skip
            raise PlantError(
                f"rotary muscle: theta = {at:g} rad has no geometry, {why}; "
                f"allowed {least:.6g} <= |theta| < {largest:.6g} rad for radius "
                f"{self.radius_m * 1e3:g} mm, length {self.length_m * 1e3:g} mm, fibre "
                f"{self.fibre_m * 1e3:g} mm"
            )
        return theta


def _half_angle(excess: Array) -> Array:
    """Solve (alpha / sin(alpha))^2 = 1 + excess for 0 < alpha <= pi/2, by Newton's method."""
    target = 0.5 * np.log1p(excess)
    alpha = np.minimum(np.sqrt(6.0 * target), math.pi / 2)
    for _ in range(60):
        # ln(alpha / sin alpha), by its series where the quotient is too near 1.
        value = np.where(
            alpha < 0.1,
            alpha**2 / 6 + alpha**4 / 180 + alpha**6 / 2835 + alpha**8 / 37800,
            np.log(alpha / np.sin(alpha)),
        )
        slope = np.where(
            alpha < 0.1,
            alpha / 3 + alpha**3 / 45 + 2 * alpha**5 / 945,
            1.0 / alpha - np.cos(alpha) / np.sin(alpha),
        )
        step = (value - target) / slope
        alpha = np.clip(alpha - step, 1e-12, math.pi / 2)
        if np.all(np.abs(step) <= 1e-15 * alpha):
            break
    return np.asarray(alpha)


def _bulge(alpha: Array) -> tuple[Array, Array]:
    """3 sin - sin^3 - 3 alpha cos, and alpha - sin cos; by series where they cancel."""
    s, c = np.sin(alpha), np.cos(alpha)
    x = np.minimum(alpha, _SERIES_BELOW)
    first, second = np.zeros_like(x), np.zeros_like(x)
    for m in range(_TERMS, 0, -1):
        sign = -1.0 if m % 2 else 1.0
        odd, even = math.factorial(2 * m + 1), math.factorial(2 * m)
        if m >= 2:  # 9/4 sin x + 1/4 sin 3x - 3 x cos x
            share = (2.25 + 0.25 * 3.0 ** (2 * m + 1)) / odd - 3.0 / even
            first = first + sign * share * x ** (2 * m + 1)
        second = second - sign * 0.5 * 2.0 ** (2 * m + 1) / odd * x ** (2 * m + 1)
    near = alpha < _SERIES_BELOW
    return (
        np.asarray(np.where(near, first, 3.0 * s - s**3 - 3.0 * alpha * c)),
        np.asarray(np.where(near, second, alpha - s * c)),
    )


def _round_slope(alpha: Array) -> Array:
    """(alpha (1 + 2 cos^2) - 3 sin cos) / (4 sin^2 (sin - alpha cos)); 1/5 for a flat bulge."""
    s, c = np.sin(alpha), np.cos(alpha)
    with np.errstate(invalid="ignore", divide="ignore"):
        plain = (alpha * (1 + 2 * c * c) - 3 * s * c) / (4 * s * s * (s - alpha * c))
    x = np.minimum(alpha, _SERIES_BELOW)
    top, bottom = np.zeros_like(x), np.zeros_like(x)
    for m in range(_TERMS, 0, -1):
        sign = -1.0 if m % 2 else 1.0
        odd, even = math.factorial(2 * m + 1), math.factorial(2 * m)
        # Of u + (u/2) cos u - (3/2) sin u at u = 2 alpha, over u^5; and of sin - alpha cos over
        # alpha^3. Their leading terms cancel exactly, so they are left out.
        if m >= 2:
            top = top + sign * (0.5 / even - 1.5 / odd) * (2 * x) ** (2 * m - 4)
        bottom = bottom + sign * (1.0 / odd - 1.0 / even) * x ** (2 * m - 2)
    sinc = np.where(x > 0, np.sin(x) / np.where(x > 0, x, 1.0), 1.0)
    series = 32.0 * top / (4.0 * sinc * sinc * bottom)
    return np.asarray(np.where(alpha < _SERIES_BELOW, series, plain))
