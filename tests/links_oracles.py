"""The same arms in Pinocchio and in MuJoCo, built joint by joint from the same numbers.

Both put a body's frame at its joint; ours stands at the link's far end. Each body here is the frame
before the link, turned by the joint.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pinocchio

from plant.arrays import Array
from plant.links import Arm, Link
from plant.links.inertia import tensor


def spatial_arm(degrees: int, seed: int) -> Arm:
    """An arm whose every number is drawn: skew axes, offsets, full inertia tensors."""
    r = np.random.default_rng(seed)
    links = []
    for i in range(degrees):
        # A cloud of point masses is a body: its tensor is one that can be.
        mass = r.uniform(0.01, 0.1, 6)
        at = r.normal(0, 0.03, (6, 3))
        com = mass @ at / mass.sum()
        from_com = at - com
        full = sum(
            m * (p @ p * np.eye(3) - np.outer(p, p)) for m, p in zip(mass, from_com, strict=True)
        )
        six = [float(full[k]) for k in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
        links.append(
            Link(
                f"joint{i}",
                r.uniform(-0.1, 0.1),
                r.uniform(-math.pi, math.pi),
                r.uniform(-0.1, 0.1),
                r.uniform(-math.pi, math.pi),
                float(mass.sum()),
                tuple(com),
                tuple(six),
            )
        )
    return Arm(f"spatial{degrees}", tuple(links), tuple(r.normal(0, 6, 3)))


def shift(link: Link) -> tuple[Array, Array]:
    """Rotation and position of a link's frame in its body's frame (the joint at zero)."""
    ca, sa = link.twist
    return np.array([[1, 0, 0], [0, ca, -sa], [0, sa, ca]]), np.array([link.a_m, 0.0, link.d_m])


def about_z(angle: float) -> Array:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])


def pinocchio_arm(arm: Arm) -> pinocchio.Model:
    model = pinocchio.Model()
    model.gravity.linear = np.array(arm.gravity_m_s2)
    at, rotation, position = 0, np.eye(3), np.zeros(3)
    for link in arm.links:
        placement = pinocchio.SE3(rotation @ about_z(link.offset_rad), position)
        at = model.addJoint(at, pinocchio.JointModelRZ(), placement, link.joint)
        rotation, position = shift(link)
        body = pinocchio.Inertia(
            link.mass_kg,
            position + rotation @ np.array(link.com_m),
            rotation @ tensor(link.inertia_kg_m2) @ rotation.T,
        )
        model.appendBodyToJoint(at, body, pinocchio.SE3.Identity())
    return model


def quaternion(rotation: Array) -> Array:
    out = np.empty(4)
    mujoco.mju_mat2Quat(out, rotation.ravel())
    # MuJoCo's own result is off by a few units in the last place of its length.
    return out / np.linalg.norm(out)


def mujoco_arm(arm: Arm) -> mujoco.MjModel:
    """A massless link, which MuJoCo refuses, lends its joint to the next body."""
    spec = mujoco.MjSpec()
    spec.option.gravity = arm.gravity_m_s2
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    spec.compiler.degree = False
    spec.compiler.balanceinertia = False
    parent, rotation, position = spec.worldbody, np.eye(3), np.zeros(3)
    waiting: list[tuple[str, float, Array, Array]] = []
    for link in arm.links:
        rotation = rotation @ about_z(link.offset_rad)
        onward, away = shift(link)
        waiting.append((link.joint, link.damping_n_m_s, rotation, position))
        if link.mass_kg == 0.0:
            rotation, position = rotation @ onward, position + rotation @ away
            continue
        body = parent.add_body(pos=position, quat=quaternion(rotation))
        for name, damping, turned, at in waiting:
            joint = body.add_joint(
                name=name, axis=rotation.T @ turned[:, 2], pos=rotation.T @ (at - position)
            )
            # A polynomial in the rate since MuJoCo 4, a number before.
            if np.ndim(joint.damping):
                joint.damping[0] = damping
            else:
                joint.damping = damping
        waiting = []
        # MuJoCo's own diagonalisation stops at 1e-12 kg m2; numpy's is exact to rounding. A thin
        # rod's moment about itself is nothing, which MuJoCo refuses; in the plane it does not act.
        moments, axes = np.linalg.eigh(onward @ tensor(link.inertia_kg_m2) @ onward.T)
        axes[:, 0] *= np.sign(np.linalg.det(axes))
        body.mass, body.explicitinertial = link.mass_kg, True
        body.ipos, body.iquat = away + onward @ np.array(link.com_m), quaternion(axes)
        body.inertia = np.maximum(moments, 1e-14)
        parent, rotation, position = body, onward, away
    return spec.compile()


def pinocchio_torque(arm: Arm, q: Array, qd: Array, qdd: Array) -> Array:
    """D q'' + h + c for each row; Pinocchio's recursion knows no joint damping."""
    model = pinocchio_arm(arm)
    data = model.createData()
    rows = [pinocchio.rnea(model, data, *row) for row in zip(q, qd, qdd, strict=True)]
    return np.array(rows)


def mujoco_torque(arm: Arm, q: Array, qd: Array, qdd: Array) -> Array:
    """D q'' + h + c + b q' for each row."""
    model = mujoco_arm(arm)
    data = mujoco.MjData(model)
    out = np.empty_like(q)
    for i in range(len(q)):
        data.qpos, data.qvel, data.qacc = q[i], qd[i], qdd[i]
        mujoco.mj_inverse(model, data)
        out[i] = data.qfrc_inverse
    return out
