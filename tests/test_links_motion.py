"""Arms in motion: energy that stays, periods that are known, other integrators' answers."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from links_oracles import mujoco_arm, spatial_arm
from plant.links import Arm, Link, LinkError, load_arm
from plant.links import dynamics as dyn
from plant.links.motion import swing

ARMS = {
    "planar2": load_arm("planar2"),
    "planar3": load_arm("planar3"),
    "finger": load_arm("finger").without_damping(),
    "spatial7": spatial_arm(7, 2),
}


def start(arm: Arm) -> tuple[np.ndarray, np.ndarray]:
    return np.full(arm.degrees, 0.5), np.linspace(1.0, 3.0, arm.degrees)


@pytest.mark.parametrize("arm", ARMS.values(), ids=list(ARMS))
def test_an_unforced_arm_keeps_its_energy_for_ten_seconds(arm: Arm) -> None:
    motion = swing(arm, *start(arm), duration_s=10.0)
    assert motion.time_s[-1] == pytest.approx(10.0)
    # It does move: far round, and fast.
    assert np.abs(motion.q[-1] - motion.q[0]).max() > 1.0
    assert motion.drift < 1e-8


def test_the_explicit_method_keeps_it_too_at_shorter_steps() -> None:
    arm = ARMS["planar3"]
    assert swing(arm, *start(arm), 10.0, step_s=5e-5, method="rk4").drift < 1e-8


@pytest.mark.parametrize("method", ["gauss6", "rk4"])
def test_the_order_of_a_method_is_what_it_says(method: str) -> None:
    """Error at 0.2 s over step length, on the finger with a torque, against a fine solution."""
    arm = ARMS["finger"]
    torque = [0.001, 0.002, -0.001, 0.0005]

    def end(step: float, how: str) -> np.ndarray:
        return swing(arm, *start(arm), 0.2, step, how, torque, every=1).q[-1]

    truth = end(1e-4, "gauss6")
    coarse = 2e-3 if method == "gauss6" else 2.5e-4
    errors = [np.abs(end(h, method) - truth).max() for h in (coarse, coarse / 2)]
    assert math.log2(errors[0] / errors[1]) > (5.5 if method == "gauss6" else 3.7)


def test_a_short_swing_agrees_with_scipy() -> None:
    arm = ARMS["finger"]
    q, qd = start(arm)

    def rates(_: float, x: np.ndarray) -> np.ndarray:
        return np.concatenate([x[4:], dyn.forward_dynamics(arm, x[:4], x[4:], np.zeros(4))])

    other = solve_ivp(
        rates, (0, 0.5), np.concatenate([q, qd]), method="DOP853", rtol=1e-12, atol=1e-12
    )
    assert np.abs(swing(arm, q, qd, 0.5).q[-1] - other.y[:4, -1]).max() < 1e-8


def test_a_damped_finger_agrees_with_mujoco() -> None:
    arm = load_arm("finger")
    q, qd = start(arm)
    model = mujoco_arm(arm)
    model.opt.timestep, model.opt.integrator = 2e-5, mujoco.mjtIntegrator.mjINT_RK4
    data = mujoco.MjData(model)
    data.qpos, data.qvel = q, qd
    for _ in range(5000):
        mujoco.mj_step(model, data)
    assert np.abs(swing(arm, q, qd, 0.1, step_s=1e-4).q[-1] - data.qpos).max() < 1e-9


def test_a_rod_swings_with_the_period_of_a_rod() -> None:
    """T = 2 pi sqrt(2 l / 3 g) for a thin rod hung by its end, small angles."""
    arm = Arm("rod", (Link.rod("pivot", 0.3, 0.1),))
    period = 2 * math.pi * math.sqrt(2 * 0.3 / (3 * 9.80665))
    amplitude = 1e-3
    motion = swing(arm, [-math.pi / 2 + amplitude], [0.0], 4 * period, every=1)
    expected = amplitude * np.cos(2 * math.pi / period * motion.time_s)
    assert np.abs(motion.q[:, 0] + math.pi / 2 - expected).max() < 2e-5 * amplitude


def test_damping_takes_the_energy_it_should() -> None:
    arm = load_arm("finger")
    motion = swing(arm, *start(arm), 0.5, every=1)
    b = np.array([link.damping_n_m_s for link in arm.links])
    power = (b * motion.qd**2).sum(axis=1)
    lost = np.trapezoid(power, motion.time_s)
    assert motion.energy_j[0] - motion.energy_j[-1] == pytest.approx(lost, rel=1e-3)


def test_what_cannot_be_integrated_is_refused() -> None:
    arm = load_arm("finger")
    with pytest.raises(LinkError, match=r"cannot follow the motion after .* steps of 1 s"):
        swing(arm, *start(arm), 10.0, step_s=1.0)
    with pytest.raises(LinkError, match="choose one of gauss6, rk4"):
        swing(arm, *start(arm), 1.0, method="euler")
    with pytest.raises(LinkError, match=r"qd has shape \(3,\), not \(4,\)"):
        swing(arm, [0, 0, 0, 0], [0, 0, 0], 1.0)
    with pytest.raises(LinkError, match="must be positive"):
        swing(arm, *start(arm), 1.0, step_s=-1e-3)
