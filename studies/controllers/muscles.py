"""Muscle model of the laws: pressures for a torque. It uses nominal constants on purpose.

A pair has the mean pressure `mean_kpa`; the agonist has mean + delta, the antagonist mean - delta.
With the law of Chou and Hannaford (4-8) the torque of a pair is linear in delta, so the conversion
is exact in both directions:

    tau = r ((mean + delta) g(L_a) - (mean - delta) g(L_b)),   g(L) = (3 L^2 - b^2) / (4 pi n^2)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plant.arrays import Array
from plant.constants import PlantConstants
from plant.finger import Finger

MEAN_KPA = 250.0


@dataclass(frozen=True)
class Pairs:
    """The muscle pairs of a finger. Deltas in kPa, torques in N m, angles in rad."""

    finger: Finger
    constants: PlantConstants
    mean_kpa: float = MEAN_KPA

    def areas(self, q: Array) -> tuple[Array, Array]:
        """G of agonists and antagonists, m2, at angles q (n,)."""
        c = self.constants
        pairs = [self.finger.pair(joint) for joint in self.finger.joints]
        radius = np.array([pair.pulley_radius_m for pair in pairs])
        rest = np.array([pair.length_m for pair in pairs])
        four_pi = 4.0 * np.pi * c.turns**2

        def area(length: Array) -> Array:
            return np.maximum(3.0 * length**2 - c.braid_length_m**2, 0.0) / four_pi

        return area(rest - radius * q), area(rest + radius * q)

    @property
    def radius(self) -> Array:
        """Pulley radii, m."""
        return np.array([self.finger.pair(joint).pulley_radius_m for joint in self.finger.joints])

    def gain(self, q: Array) -> Array:
        """Torque per kPa of delta, N m/kPa."""
        agonist, antagonist = self.areas(q)
        return np.asarray(self.radius * (agonist + antagonist) * 1e3)

    def delta(self, q: Array, torque: Array) -> Array:
        """Delta (n,) that gives `torque` at angles q."""
        agonist, antagonist = self.areas(q)
        mean = self.mean_kpa * 1e3 * (agonist - antagonist)
        return np.asarray((torque / self.radius - mean) / (agonist + antagonist) * 1e-3)

    def torque(self, q: Array, delta_kpa: Array) -> Array:
        """Torque (n,) of the pairs at angles q."""
        agonist, antagonist = self.areas(q)
        mean, delta = self.mean_kpa * 1e3, delta_kpa * 1e3
        return np.asarray(self.radius * ((mean + delta) * agonist - (mean - delta) * antagonist))

    def stiffness(self, q: Array, delta_kpa: Array) -> Array:
        """-d tau / dq at constant delta, N m/rad."""
        step = 1e-5
        below, above = self.torque(q - step, delta_kpa), self.torque(q + step, delta_kpa)
        return np.asarray((below - above) / (2.0 * step))

    def pressures(self, delta_kpa: Array) -> Array:
        """Set-points (2 n,): agonist and antagonist of each joint, kPa."""
        limit = self.mean_kpa
        delta = np.clip(delta_kpa, -limit, limit)
        return np.stack([self.mean_kpa + delta, self.mean_kpa - delta], axis=-1).ravel()
