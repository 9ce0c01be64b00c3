"""Link dynamics against Pinocchio, MuJoCo, energy, and what any inertia matrix must be."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio
import pytest

from links_oracles import mujoco_torque, pinocchio_arm, pinocchio_torque, spatial_arm
from plant.arrays import Array
from plant.links import Arm, LinkError, load_arm
from plant.links import dynamics as dyn
from plant.links.newton_euler import newton_euler
from plant.links.onestate import OneState

ARMS = {
    "planar2": load_arm("planar2"),
    "planar3": load_arm("planar3"),
    "finger": load_arm("finger"),
    "spatial4": spatial_arm(4, 1),
    "spatial7": spatial_arm(7, 2),
}
STATES = 1000
each_arm = pytest.mark.parametrize("arm", ARMS.values(), ids=list(ARMS))


def states(arm: Arm, count: int = STATES) -> list[Array]:
    """Angles all round, rates to 20 rad/s, accelerations to 500 rad/s2."""
    r = np.random.default_rng(20_260)
    return [r.uniform(-top, top, (count, arm.degrees)) for top in (np.pi, 20.0, 500.0)]


def off(ours: Array, theirs: Array) -> float:
    """Largest difference in any state, as a share of that state's largest torque."""
    return float((np.abs(ours - theirs).max(axis=1) / np.abs(theirs).max(axis=1)).max())


def damping(arm: Arm) -> Array:
    return np.array([link.damping_n_m_s for link in arm.links])


@each_arm
def test_inverse_dynamics_agree_with_pinocchio(arm: Arm) -> None:
    q, qd, qdd = states(arm)
    theirs = pinocchio_torque(arm, q, qd, qdd) + damping(arm) * qd
    assert off(dyn.inverse_dynamics(arm, q, qd, qdd), theirs) < 1e-12


@each_arm
def test_inverse_dynamics_agree_with_mujoco(arm: Arm) -> None:
    q, qd, qdd = states(arm)
    theirs = mujoco_torque(arm, q, qd, qdd)
    assert off(dyn.inverse_dynamics(arm, q, qd, qdd), theirs) < 1e-12


@each_arm
def test_compiled_agrees_with_the_readable_recursion(arm: Arm) -> None:
    q, qd, qdd = states(arm)
    plain = np.array([newton_euler(arm, *row) for row in zip(q, qd, qdd, strict=True)])
    assert off(dyn.inverse_dynamics(arm, q, qd, qdd), plain) < 1e-12


@each_arm
def test_inertia_matrix_agrees_with_pinocchio_and_with_unit_accelerations(arm: Arm) -> None:
    q, _, _ = states(arm, 200)
    d = dyn.inertia_matrix(arm, q)
    model = pinocchio_arm(arm)
    data = model.createData()
    for row, ours in zip(q, d, strict=True):
        upper = np.triu(pinocchio.crba(model, data, row))
        theirs = upper + np.triu(upper, 1).T
        assert np.abs(ours - theirs).max() < 1e-12 * np.abs(theirs).max()
    still = np.zeros_like(q)
    for k in range(arm.degrees):
        unit = still + np.eye(arm.degrees)[k]
        column = dyn.inverse_dynamics(arm, q, still, unit) - dyn.gravity_torque(arm, q)
        # A difference of torques: gravity's size sets its rounding.
        size = np.abs(d).max() + np.abs(dyn.gravity_torque(arm, q)).max()
        assert np.abs(column - d[:, :, k]).max() < 1e-13 * size


@each_arm
def test_inertia_matrix_is_symmetric_and_positive_definite(arm: Arm) -> None:
    d = dyn.inertia_matrix(arm, states(arm)[0])
    assert np.array_equal(d, d.transpose(0, 2, 1))
    assert np.linalg.eigvalsh(d).min() > 0.0


@each_arm
def test_forward_undoes_inverse(arm: Arm) -> None:
    q, qd, qdd = states(arm)
    torque = dyn.inverse_dynamics(arm, q, qd, qdd)
    # Torques are exact to rounding; an ill-conditioned D turns it into more of acceleration.
    back = dyn.forward_dynamics(arm, q, qd, torque)
    assert off(dyn.inverse_dynamics(arm, q, qd, back), torque) < 1e-12
    assert off(back, qdd) < 1e-10


@each_arm
def test_coriolis_matrix_gives_h_and_agrees_with_pinocchio(arm: Arm) -> None:
    q, qd, _ = states(arm, 200)
    c = dyn.coriolis_matrix(arm, q, qd)
    h = dyn.velocity_torque(arm, q, qd)
    assert off(np.einsum("bij,bj->bi", c, qd), h) < 1e-12
    model = pinocchio_arm(arm)
    data = model.createData()
    for row, rate, ours in zip(q, qd, c, strict=True):
        theirs = pinocchio.computeCoriolisMatrix(model, data, row, rate)
        # C is not unique; its symmetric part is D'/2 and its product with the rates is h.
        assert np.abs(ours + ours.T - theirs - theirs.T).max() < 1e-12 * np.abs(theirs).max()


@each_arm
def test_energy_is_what_pinocchio_says(arm: Arm) -> None:
    q, qd, _ = states(arm, 200)
    model = pinocchio_arm(arm)
    data = model.createData()
    theirs = np.array(
        [pinocchio.computeMechanicalEnergy(model, data, *row) for row in zip(q, qd, strict=True)]
    )
    assert np.abs(dyn.total_energy(arm, q, qd) - theirs).max() < 1e-12 * np.abs(theirs).max()
    apart = dyn.kinetic_energy(arm, q, qd) + dyn.potential_energy(arm, q)
    assert np.abs(apart - theirs).max() < 1e-12 * np.abs(theirs).max()


def test_three_links_become_two_when_one_shrinks_to_nothing() -> None:
    """Section 2.4: mass and length of any one of the three set to zero."""
    three = ARMS["planar3"]
    for gone in range(3):
        rest = [k for k in range(3) if k != gone]
        two = Arm("two", tuple(three.links[k] for k in rest), three.gravity_m_s2)
        state = states(three)
        # Angles count from the link before: the lost joint still turns the link after it.
        joined = [x.copy() for x in state]
        for x in joined:
            if gone < 2:
                x[:, gone + 1] += x[:, gone]
        ours = dyn.inverse_dynamics(three.without_link(three.joints[gone]), *state)
        theirs = dyn.inverse_dynamics(two, *(x[:, rest] for x in joined))
        assert off(ours[:, rest], theirs) < 1e-13
        borne = ours[:, gone + 1] if gone < 2 else np.zeros(STATES)
        assert np.allclose(ours[:, gone], borne, rtol=1e-12, atol=1e-15)
    assert [link.mass_kg for link in two.links] == [k.mass_kg for k in ARMS["planar2"].links]


def test_a_batch_is_its_rows_and_one_state_needs_no_batch() -> None:
    arm = ARMS["finger"]
    q, qd, qdd = states(arm, 5)
    batch = dyn.inverse_dynamics(arm, q, qd, qdd)
    assert batch.shape == (5, 4)
    for k in range(5):
        assert np.array_equal(dyn.inverse_dynamics(arm, q[k], qd[k], qdd[k]), batch[k])
    assert dyn.inertia_matrix(arm, q[0]).shape == (4, 4)
    assert dyn.total_energy(arm, q[0], qd[0]).shape == ()
    assert dyn.coriolis_matrix(arm, q[0], qd[0]).shape == (4, 4)


@each_arm
def test_one_state_a_call_gives_what_the_batch_gives(arm: Arm) -> None:
    q, qd, qdd = states(arm, 20)
    one = OneState(arm)
    for number, expected in enumerate(dyn.inverse_dynamics(arm, q, qd, qdd)):
        got = one.inverse_dynamics(q[number], qd[number], qdd[number])
        assert got is one.torque
        np.testing.assert_array_equal(got, expected)


@pytest.mark.parametrize("q", [np.zeros(4), np.zeros(2), np.zeros(6)[::2], np.zeros(3, np.float32),
                               np.zeros((1, 3)), [0.0, 0.0, 0.0], None])  # fmt: skip
def test_what_is_no_state_is_refused_and_not_read_beyond_its_end(q: Any) -> None:
    zero = np.zeros(3)
    with pytest.raises(LinkError, match=r"expected contiguous float64 arrays \(3,\)"):
        OneState(ARMS["planar3"]).inverse_dynamics(q, zero, zero)


def test_a_payload_is_a_point_mass_at_the_tip() -> None:
    """Against Pinocchio with the mass appended to its last joint."""
    arm = ARMS["finger"].without_damping()
    model = pinocchio_arm(arm)
    tip = pinocchio.Inertia(0.020, np.array([0.022, 0.0, 0.0]), np.zeros((3, 3)))
    model.appendBodyToJoint(4, tip, pinocchio.SE3.Identity())
    data = model.createData()
    q, qd, qdd = states(arm, 100)
    theirs = np.array([pinocchio.rnea(model, data, *r) for r in zip(q, qd, qdd, strict=True)])
    assert off(dyn.inverse_dynamics(arm.with_payload(0.020), q, qd, qdd), theirs) < 1e-12


def test_a_joint_that_moves_nothing_has_no_acceleration_to_tell() -> None:
    arm = ARMS["planar3"].without_link("third")
    with pytest.raises(LinkError, match="singular in state 0"):
        dyn.forward_dynamics(arm, [0, 0, 0], [0, 0, 0], [0, 0, 0])


def test_states_of_the_wrong_shape_are_refused() -> None:
    with pytest.raises(LinkError, match=r"qd has shape \(2,\); expected \(3,\)"):
        dyn.inverse_dynamics(ARMS["planar3"], [0, 0, 0], [0, 0], [0, 0, 0])


@pytest.mark.campaign
def test_batches_are_faster_than_a_call_of_pinocchio_or_mujoco() -> None:
    from benchmarks.links import measured, ways_of

    best = measured(ways_of("planar3"))
    ours = best["pamrig, compiled, batch"]
    assert ours < best["Pinocchio rnea, Python call"]
    assert ours < best["MuJoCo mj_inverse, Python call"]
