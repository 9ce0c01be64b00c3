"""Linear model of the finger about a posture, for pole placement and tuning.

    D q'' + B q' + K (q - q0) = G delta,    T delta' = delta_asked(t - L) - delta

K is the stiffness of muscles (at constant pressures) and gravity, G the torque per kPa, T and L
are lag and dead time of the pressure loop (`tuning.pressure_response`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import expm

from plant.arrays import Array
from plant.links.dynamics import gravity_torque, inertia_matrix
from studies.controllers.muscles import Pairs


@dataclass(frozen=True)
class Linear:
    """x = (q - q0, q', delta - delta0), 3 n states; u = delta_asked - delta0 (kPa), n inputs.

    `a` (3 n, 3 n) and `b` (3 n, n) are in continuous time, without the dead time.
    """

    q0: Array
    delta0: Array
    a: Array
    b: Array
    gain: Array
    stiffness: Array

    @property
    def degrees(self) -> int:
        """Number of joints."""
        return len(self.q0)

    def sampled(self, step_s: float) -> tuple[Array, Array]:
        """Exact a and b for an input that is constant over each step."""
        size, inputs = self.b.shape
        block = np.zeros((size + inputs, size + inputs))
        block[:size, :size] = self.a
        block[:size, size:] = self.b
        whole = expm(block * step_s)
        return whole[:size, :size], whole[:size, size:]

    @property
    def rates(self) -> npt.NDArray[np.complex128]:
        """Poles of finger and pressures, 1/s."""
        return np.asarray(np.linalg.eigvals(self.a), dtype=np.complex128)

    @property
    def slowest_period_s(self) -> float:
        """Period of the slowest oscillation."""
        waves = self.rates[self.rates.imag > 1.0]
        return float(2.0 * np.pi / np.abs(waves).min())


def linear_model(pairs: Pairs, q0: Array, lag_s: float) -> Linear:
    """Linearise the nominal finger about a posture at rest."""
    arm = pairs.finger.arm
    n = arm.degrees
    held = gravity_torque(arm, q0)
    delta0 = pairs.delta(q0, held)
    step = 1e-5
    weight = np.stack(
        [
            (gravity_torque(arm, q0 + step * e) - gravity_torque(arm, q0 - step * e)) / (2 * step)
            for e in np.eye(n)
        ],
        axis=-1,
    )
    stiffness = np.diag(pairs.stiffness(q0, delta0)) + weight
    gain = np.diag(pairs.gain(q0))
    damping = np.diag([link.damping_n_m_s for link in arm.links])
    inverse = np.linalg.inv(inertia_matrix(arm, q0))
    a = np.zeros((3 * n, 3 * n))
    a[:n, n : 2 * n] = np.eye(n)
    a[n : 2 * n, :n] = -inverse @ stiffness
    a[n : 2 * n, n : 2 * n] = -inverse @ damping
    a[n : 2 * n, 2 * n :] = inverse @ gain
    a[2 * n :, 2 * n :] = -np.eye(n) / lag_s
    b = np.zeros((3 * n, n))
    b[2 * n :] = np.eye(n) / lag_s
    return Linear(np.asarray(q0, dtype=float), delta0, a, b, gain, stiffness)
