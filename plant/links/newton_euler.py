"""Newton-Euler as in chapter 2 of the thesis, in base coordinates and plain numpy.

A short reference implementation of equations 2-4 to 2-13, to check the compiled kernel, which uses
link coordinates. Differences to the print: joint i rotates about the z axis of frame i-1, as in the
Lagrange-Euler section of the thesis; 2-6 and 2-7 use omega(i) throughout; and 2-12 must be n(i) =
n(i+1) + p(i) x f(i+1) + (p(i) + s(i)) x F(i) + N(i).
"""

from __future__ import annotations

import numpy as np

from plant.arrays import Array
from plant.links.arm import Arm
from plant.links.inertia import tensor
from plant.links.kinematics import link_frames


def newton_euler(arm: Arm, q: Array, qd: Array, qdd: Array) -> Array:
    """Torques (n) for one state: D q'' + h + c + b q'; rad, rad/s, rad/s2, N m."""
    frames = link_frames(arm, q)
    n = arm.degrees
    rate, push = np.zeros(3), np.zeros(3)
    # Gravity is modelled as an upward acceleration of the base.
    accel = -arm.gravity
    force, moment = np.empty((n, 3)), np.empty((n, 3))
    for i, link in enumerate(arm.links):
        axis = frames[i][:3, 2]
        rotation = frames[i + 1][:3, :3]
        push = push + axis * qdd[i] + np.cross(rate, axis * qd[i])
        rate = rate + axis * qd[i]
        step = frames[i + 1][:3, 3] - frames[i][:3, 3]
        accel = accel + np.cross(push, step) + np.cross(rate, np.cross(rate, step))
        com = rotation @ np.array(link.com_m)
        body = rotation @ tensor(link.inertia_kg_m2) @ rotation.T
        force[i] = link.mass_kg * (
            accel + np.cross(push, com) + np.cross(rate, np.cross(rate, com))
        )
        moment[i] = body @ push + np.cross(rate, body @ rate)
    torque = np.empty(n)
    f, m = np.zeros(3), np.zeros(3)
    for i in reversed(range(n)):
        link = arm.links[i]
        step = frames[i + 1][:3, 3] - frames[i][:3, 3]
        arm_to_com = step + frames[i + 1][:3, :3] @ np.array(link.com_m)
        m = m + np.cross(step, f) + np.cross(arm_to_com, force[i]) + moment[i]
        f = f + force[i]
        torque[i] = frames[i][:3, 2] @ m + link.damping_n_m_s * qd[i]
    return torque
