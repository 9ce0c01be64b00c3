"""Control without feedback of the angle: pressures from the muscle model and a firmware scheme.

The error of the angle is caused by the pressure error of the scheme. The schemes of the thesis are
evaluated in this way, because they control pressures only.
"""

from __future__ import annotations

from plant.arrays import Array
from plant.links.dynamics import gravity_torque
from studies.controllers.muscles import Pairs
from studies.controllers.reference import Reference


class StaticMap:
    """Delta of the reference angle at rest, with gravity."""

    def __init__(self, pairs: Pairs) -> None:
        self._pairs = pairs
        self._reference: Reference | None = None

    def start(self, reference: Reference, q: Array) -> None:
        """Store the reference."""
        self._reference = reference

    def delta(self, time_s: float, q: Array) -> Array:
        """Delta of the reference angle."""
        assert self._reference is not None
        wanted, _, _ = self._reference.at(time_s)
        return self._pairs.delta(wanted, gravity_torque(self._pairs.finger.arm, wanted))
