"""Correction of a gap for radial lens distortion."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from vision.marker.gap import GapMeasurement


@dataclass(frozen=True)
class Lens:
    """Radial lens distortion: t = s (1 + k1 r^2 + k2 r^4), r = |s|/radius.

    s is the observed point and t the true point, relative to the centre.

    centre_x, centre_y and radius are in pixels; k1 and k2 are dimensionless; u_k1 is the
    standard uncertainty of k1. Brown's model without the tangential part, inverse direction.
    """

    centre_x: float
    centre_y: float
    radius: float
    k1: float = 0.0
    k2: float = 0.0
    u_k1: float = 0.0

    def true(self, x: float, y: float) -> tuple[float, float]:
        """Position of a point observed at (x, y), without distortion."""
        dx, dy = x - self.centre_x, y - self.centre_y
        r2 = (dx * dx + dy * dy) / self.radius**2
        factor = 1.0 + self.k1 * r2 + self.k2 * r2 * r2
        return self.centre_x + dx * factor, self.centre_y + dy * factor

    def gap(self, measured: GapMeasurement) -> tuple[float, float]:
        """The gap without distortion and its standard uncertainty, in pixels.

        The two points lie at the middle of the rows common to both edges, along the common
        normal of the fitted edges. nan if there is no measurement.
        """
        left, right = measured.left, measured.right
        if left is None or right is None or not math.isfinite(measured.pixels):
            return math.nan, math.nan
        y = 0.25 * (left.top + left.bottom + right.top + right.bottom)
        slope = 0.5 * (left.slope + right.slope)
        normal = np.array([1.0, -slope]) / math.hypot(1.0, slope)
        foot = np.array([left.x_at(y), y])
        other = foot + measured.pixels * normal
        gap = float(normal @ (np.array(self.true(*other)) - np.array(self.true(*foot))))
        a, b = (point - [self.centre_x, self.centre_y] for point in (foot, other))
        r2a, r2b = (float((s**2).sum()) / self.radius**2 for s in (a, b))
        rate = float(normal @ (b * r2b) - normal @ (a * r2a))
        return gap, math.hypot(measured.u_pixels * gap / measured.pixels, self.u_k1 * rate)
