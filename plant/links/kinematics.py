"""Kinematics of an arm: link frames, tip position, tip Jacobian."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from plant.arrays import Array
from plant.links.arm import Arm, Link


def link_matrix(link: Link, q: float) -> Array:
    """The 4 x 4 matrix A of one link (thesis, section 2.2): from its frame to the previous one."""
    ca, sa = link.twist
    ct, st = math.cos(q + link.offset_rad), math.sin(q + link.offset_rad)
    return np.array(
        [
            [ct, -ca * st, sa * st, link.a_m * ct],
            [st, ca * ct, -sa * ct, link.a_m * st],
            [0.0, sa, ca, link.d_m],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def link_frames(arm: Arm, q: npt.ArrayLike) -> list[Array]:
    """Base frame (identity) and frame of each link in the base frame; n + 1 matrices 4 x 4, m."""
    frames = [np.eye(4)]
    for link, angle in zip(arm.links, np.asarray(q, dtype=float), strict=True):
        frames.append(frames[-1] @ link_matrix(link, float(angle)))
    return frames


def tip_position(arm: Arm, q: npt.ArrayLike) -> Array:
    """Origin of the last link's frame in the base frame, (3,), m."""
    return np.array(link_frames(arm, q)[-1][:3, 3])


def tip_jacobian(arm: Arm, q: npt.ArrayLike) -> Array:
    """Jacobian of the tip position with respect to the joint angles, (3, n), m/rad."""
    frames = link_frames(arm, q)
    tip = frames[-1][:3, 3]
    return np.stack([np.cross(f[:3, 2], tip - f[:3, 3]) for f in frames[:-1]], axis=1)
