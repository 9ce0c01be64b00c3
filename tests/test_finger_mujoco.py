"""The finger beside MuJoCo: frames, and motion under the muscles' torques."""

from __future__ import annotations

import mujoco
import numpy as np

from links_oracles import mujoco_arm
from plant.constants import nominal
from plant.finger import FingerSim, load_finger
from plant.links.dynamics import gravity_torque
from plant.links.kinematics import link_frames
from plant.physics.muscle import braid_force, braid_volume
from studies.controllers.muscles import Pairs
from studies.controllers.reference import tips


def test_frames_are_mujocos() -> None:
    arm = load_finger().arm
    model = mujoco_arm(arm)
    data = mujoco.MjData(model)
    r = np.random.default_rng(5)
    for q in r.uniform(-1.5, 1.5, (50, 4)):
        data.qpos = q
        mujoco.mj_kinematics(model, data)
        frames = link_frames(arm, q)
        # Bodies stand at the base, and at the ends of the first and second link.
        for body, frame in ((1, 0), (2, 2), (3, 3)):
            np.testing.assert_allclose(data.xpos[body], frames[frame][:3, 3], atol=1e-15)
        last = data.xmat[3].reshape(3, 3) @ np.array([arm.links[3].a_m, 0.0, 0.0])
        np.testing.assert_allclose(data.xpos[3] + last, frames[4][:3, 3], atol=1e-15)
        np.testing.assert_allclose(tips(arm, q[None])[0], frames[4][:3, 3], atol=1e-15)


def test_motion_under_the_same_torques() -> None:
    """Valves shut, a payload let go: MuJoCo integrates, the muscles' torque is told it by q."""
    c = nominal()
    finger = load_finger()
    pairs = Pairs(finger, c)
    q = np.radians([3.0, 10.0, 30.0, 20.0])
    pressure = pairs.pressures(pairs.delta(q, gravity_torque(finger.arm, q)))
    sim = FingerSim(finger, c, payload_kg=0.02, q_rad=q, pressure_kpa=pressure, step_max_s=1e-4)
    rest_m, arm_m = finger.tendons[:, 1], finger.tendons[:, 2]

    def volume(length: np.ndarray) -> np.ndarray:
        return np.asarray(braid_volume(length, c.braid_length_m, c.turns) + c.dead_volume_m3)

    content = (pressure * 1e3 + c.atmosphere_pa) * volume(rest_m + arm_m * np.repeat(q, 2))

    def pull(model: object, data: mujoco.MjData) -> None:
        length = rest_m + arm_m * np.repeat(data.qpos, 2)
        gauge = content / volume(length) - c.atmosphere_pa
        force = np.maximum(braid_force(gauge, length, c.braid_length_m, c.turns), 0.0)
        data.qfrc_passive[:] -= (force * arm_m).reshape(4, 2).sum(axis=1)

    model = mujoco_arm(finger.with_payload(0.02).arm)
    model.opt.timestep = 1e-4
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    data = mujoco.MjData(model)
    data.qpos = q
    mujoco.set_mjcb_passive(pull)
    try:
        mujoco.mj_step(model, data, 1000)
    finally:
        mujoco.set_mjcb_passive(None)
    sim.replay(1e-3, np.zeros((100, 8, 2)))
    assert np.degrees(np.abs(data.qpos - q)).max() > 3.0
    assert np.degrees(np.abs(data.qpos - sim.q_rad)).max() < 1e-4
