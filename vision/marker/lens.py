"""Radial lens distortion of a gap, in the plane the camera looks at."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vision.marker.gap import GapMeasurement

F64 = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Lens:
    """Seen point s and true point t about the centre: t = s (1 + k1 r^2 + k2 r^4), r = |s|/radius.

    centre_x, centre_y and radius are in pixels; k1 and k2 have no unit and u_k1 is the
    standard uncertainty of k1. Brown's model without its tangential part, inverse direction.
    """

    centre_x: float
    centre_y: float
    radius: float
    k1: float = 0.0
    k2: float = 0.0
    u_k1: float = 0.0

    def true(self, x: float, y: float) -> tuple[float, float]:
        """Where a point seen at (x, y) would be seen through a lens without distortion."""
        dx, dy = x - self.centre_x, y - self.centre_y
        r2 = (dx * dx + dy * dy) / self.radius**2
        factor = 1.0 + self.k1 * r2 + self.k2 * r2 * r2
        return self.centre_x + dx * factor, self.centre_y + dy * factor

    def gap(self, measured: GapMeasurement) -> tuple[float, float]:
        """Gap and its standard uncertainty, in pixels, freed of distortion.

        Both edges are taken at the row half-way down the rows they share, along the common
        normal of the fitted edges. nan where there is no measurement.
        """
        left, right = measured.left, measured.right
        if left is None or right is None or not math.isfinite(measured.pixels):
            return math.nan, math.nan
        y = 0.25 * (left.top + left.bottom + right.top + right.bottom)
        slope = 0.5 * (left.slope + right.slope)
        normal = np.array([1.0, -slope]) / math.hypot(1.0, slope)
        foot = np.array([left.x_at(y), y])
        other = foot + measured.pixels * normal
        a, b = np.array(self.true(*foot)), np.array(self.true(*other))
        gap = float(normal @ (b - a))
        r2a = float(((foot - [self.centre_x, self.centre_y]) ** 2).sum()) / self.radius**2
        r2b = float(((other - [self.centre_x, self.centre_y]) ** 2).sum()) / self.radius**2
        rate = float(
            normal @ ((other - [self.centre_x, self.centre_y]) * r2b)
            - normal @ ((foot - [self.centre_x, self.centre_y]) * r2a)
        )
        return gap, math.hypot(measured.u_pixels * gap / measured.pixels, self.u_k1 * rate)
