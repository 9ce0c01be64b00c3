"""Inverse dynamics for a control loop: one arm, one state a call, as little as possible around it.

`dynamics.inverse_dynamics` takes whatever can be made an array and any batch, and spends five
microseconds on finding out; here the arm is laid out once and a call takes the arrays as they are.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from plant.links import kernel
from plant.links.arm import Arm
from plant.links.errors import LinkError

Array = npt.NDArray[np.float64]


class OneState:
    """An arm whose torques are asked for one state at a time.

    Args:
        arm: as it is now; make a new one for another payload.

    Attributes:
        torque: (n,), N m, of the last state; the next call writes over it.
    """

    __slots__ = ("_arm", "_call", "_pad", "torque")

    def __init__(self, arm: Arm) -> None:
        n = arm.degrees
        self._arm = arm
        self._call = kernel.inverse_one
        room = np.zeros((kernel.WORK + 1) * n)
        self._pad = np.concatenate([arm.gravity, arm.table.ravel(), room])
        self.torque: Array = self._pad[-n:]

    def inverse_dynamics(self, q: Array, qd: Array, qdd: Array) -> Array:
        """Torques that give the accelerations `qdd`: :attr:`torque` itself, no copy of it.

        Args:
            q, qd, qdd: contiguous float64 arrays (n,); rad, rad/s, rad/s2.

        Raises:
            LinkError: they are something else.
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
