"""Dynamics of an arm, for one state or a batch: D q'' + h(q, q') + c(q) + b q' = torque.

Angles in rad, rates in rad/s, torques in N m; arrays (n,) or (batch, n) for n joints, results of
the same shape. h: Coriolis and centrifugal torques; c: gravity torques; b: joint damping.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from plant.arrays import Array
from plant.errors import LinkError
from plant.links import kernel
from plant.links.arm import Arm


def inverse_dynamics(arm: Arm, q: npt.ArrayLike, qd: npt.ArrayLike, qdd: npt.ArrayLike) -> Array:
    """Torques for the accelerations `qdd`. Raises `LinkError` for wrong shapes."""
    q, qd, qdd = _rows(arm, q=q, qd=qd, qdd=qdd)
    out = np.empty_like(q)
    kernel.inverse_batch(arm.table, arm.gravity, *_flat(arm, q, qd, qdd, out))
    return out


def forward_dynamics(arm: Arm, q: npt.ArrayLike, qd: npt.ArrayLike, torque: npt.ArrayLike) -> Array:
    """Accelerations for given torques.

    Raises `LinkError` for wrong shapes and if a joint moves no inertia.
    """
    q, qd, torque = _rows(arm, q=q, qd=qd, torque=torque)
    out = np.empty_like(q)
    bad = kernel.forward_batch(arm.table, arm.gravity, *_flat(arm, q, qd, torque, out))
    if bad >= 0:
        raise LinkError(
            f"arm {arm.name!r}: its inertia matrix is singular in state {bad}, so its "
            "accelerations are not determined; give the links after each joint mass or inertia"
        )
    return out


def inertia_matrix(arm: Arm, q: npt.ArrayLike) -> Array:
    """D, symmetric, in kg m2; shape (n, n) or (batch, n, n)."""
    (q,) = _rows(arm, q=q)
    out = np.empty((*q.shape, arm.degrees))
    (flat,) = _flat(arm, q)
    kernel.mass_batch(arm.table, flat, out.reshape(-1, arm.degrees, arm.degrees))
    return out


def gravity_torque(arm: Arm, q: npt.ArrayLike) -> Array:
    """c: torques that hold the arm still against gravity."""
    (q,) = _rows(arm, q=q)
    still = np.zeros_like(q)
    return inverse_dynamics(arm, q, still, still)


def velocity_torque(arm: Arm, q: npt.ArrayLike, qd: npt.ArrayLike) -> Array:
    """h: Coriolis and centrifugal torques, without damping."""
    q, qd = _rows(arm, q=q, qd=qd)
    out = np.empty_like(q)
    flat = _flat(arm, q, qd, np.zeros_like(q), out)
    kernel.inverse_batch(arm.without_damping().table, np.zeros(3), *flat)
    return out


def coriolis_matrix(arm: Arm, q: npt.ArrayLike, qd: npt.ArrayLike) -> Array:
    """C of h = C q' from Christoffel symbols, so that D' - 2 C is skew-symmetric.

    h is quadratic in the rates, so its polar form is exact:
    column k of C is (h(q' + e_k) - h(q') - h(e_k)) / 2.
    """
    q, qd = _rows(arm, q=q, qd=qd)
    columns = []
    for k in range(arm.degrees):
        # Of the size of the rates, so that the differences lose no digits.
        size = np.maximum(np.abs(qd).max(axis=-1, keepdims=True), 1.0)
        unit = size * np.eye(arm.degrees)[k] + np.zeros_like(qd)
        both = velocity_torque(arm, q, qd + unit)
        apart = velocity_torque(arm, q, qd) + velocity_torque(arm, q, unit)
        columns.append((both - apart) / (2.0 * size))
    return np.stack(columns, axis=-1)


def total_energy(arm: Arm, q: npt.ArrayLike, qd: npt.ArrayLike) -> Array:
    """Kinetic plus potential energy, J; shape () or (batch,).

    The potential is zero for a body at the origin of the base frame.
    """
    q, qd = _rows(arm, q=q, qd=qd)
    out = np.empty(q.shape[:-1])
    q, qd = _flat(arm, q, qd)
    kernel.energy_batch(arm.table, arm.gravity, q, qd, out.reshape(-1))
    return out


def kinetic_energy(arm: Arm, q: npt.ArrayLike, qd: npt.ArrayLike) -> Array:
    """Half of q' D q', J; shape () or (batch,)."""
    q, qd = _rows(arm, q=q, qd=qd)
    return np.asarray(0.5 * np.einsum("...i,...ij,...j", qd, inertia_matrix(arm, q), qd))


def potential_energy(arm: Arm, q: npt.ArrayLike) -> Array:
    """Potential energy of gravity, J; shape () or (batch,)."""
    (q,) = _rows(arm, q=q)
    return total_energy(arm, q, np.zeros_like(q))


def _rows(arm: Arm, **given: npt.ArrayLike) -> list[Array]:
    """Contiguous float arrays of the same shape, last axis the joints."""
    arrays = {k: np.ascontiguousarray(v, dtype=np.float64) for k, v in given.items()}
    shape = next(iter(arrays.values())).shape
    for name, array in arrays.items():
        if array.ndim not in (1, 2) or array.shape[-1] != arm.degrees or array.shape != shape:
            raise LinkError(
                f"arm {arm.name!r}: {name} has shape {array.shape}; expected ({arm.degrees},) or "
                f"(batch, {arm.degrees}), the same for all, for joints {', '.join(arm.joints)}"
            )
    return list(arrays.values())


def _flat(arm: Arm, *arrays: Array) -> list[Array]:
    return [a.reshape(-1, arm.degrees) for a in arrays]
