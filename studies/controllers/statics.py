"""No feedback of the angle at all: pressures from the muscle's law, held by the firmware's scheme.

What is left of the angle's error is what the scheme leaves of the pressure's. The thesis's own
schemes are judged this way: they control pressures and know of no joint.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from plant.links.dynamics import gravity_torque
from studies.controllers.muscles import Pairs
from studies.controllers.reference import Reference

Array = npt.NDArray[np.float64]


class StaticMap:
    """Delta of the wanted angle at rest, gravity included."""

    def __init__(self, pairs: Pairs) -> None:
        self._pairs = pairs
        self._reference: Reference | None = None

    def start(self, reference: Reference, q: Array) -> None:
        """Take the reference."""
        self._reference = reference

    def delta(self, time_s: float, q: Array) -> Array:
        """The wanted angle's own delta."""
        assert self._reference is not None
        wanted, _, _ = self._reference.at(time_s)
        return self._pairs.delta(wanted, gravity_torque(self._pairs.finger.arm, wanted))
