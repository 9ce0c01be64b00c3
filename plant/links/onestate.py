"""Fast inverse dynamics for a control loop: one arm, one state per call.

`dynamics.inverse_dynamics` converts its arguments and accepts batches, which costs five
microseconds per call. Here the arm is prepared once and the arrays are used without conversion.
"""

from __future__ import annotations

import numpy as np

from plant.arrays import Array
from plant.errors import LinkError
from plant.links import kernel
from plant.links.arm import Arm
from plant.links.layout import WORK


class OneState:
    """Computes the torques of an arm for one state at a time.

    Args:
        arm: the arm; make a new object for another payload.

    Attributes:
        torque: (n,), N m, for the last state; the next call overwrites it.
    """

    __slots__ = ("_arm", "_call", "_pad", "torque")

    def __init__(self, arm: Arm) -> None:
        n = arm.degrees
        self._arm = arm
        self._call = kernel.inverse_one
        room = np.zeros((WORK + 1) * n)
        self._pad = np.concatenate([arm.gravity, arm.table.ravel(), room])
        self.torque: Array = self._pad[-n:]

    def inverse_dynamics(self, q: Array, qd: Array, qdd: Array) -> Array:
        """Torques for the accelerations `qdd`; returns :attr:`torque` itself, not a copy.

        Args:
            q, qd, qdd: contiguous float64 arrays (n,); rad, rad/s, rad/s2.

        Raises:
            LinkError: wrong types or shapes.
        """
        try:
            if self._call(self._pad, q, qd, qdd):
                return self.torque
        except TypeError:
            pass
        given = ", ".join(
            f"{getattr(a, 'dtype', type(a).__name__)} {np.shape(a)}" for a in (q, qd, qdd)
        )
        raise LinkError(
            f"arm {self._arm.name!r}: q, qd, qdd are {given}; expected contiguous float64 arrays "
            f"({self._arm.degrees},), for joints {', '.join(self._arm.joints)}"
        )
