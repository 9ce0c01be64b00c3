"""Arms and bodies: what is read, what is refused, what the thesis prints wrong."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy
from hypothesis import given, settings
from hypothesis import strategies as st

from plant.links import Arm, Link, LinkError, load_arm
from plant.links import dynamics as dyn
from plant.links.inertia import (
    check_inertia,
    from_pseudo_inertia,
    pseudo_inertia,
    rod_inertia,
    tensor,
)
from plant.links.kinematics import tip_jacobian, tip_position
from plant.links.symbolic.appendix import SYMBOLS, derived_equations, differences, printed_equations
from plant.tomlfile import shipped_names

clouds = st.lists(
    st.tuples(*[st.floats(-0.1, 0.1)] * 3, st.floats(1e-3, 1.0)), min_size=1, max_size=8
)


def body(points: np.ndarray) -> tuple[float, Any, Any]:
    mass = points[:, 3]
    com = mass @ points[:, :3] / mass.sum()
    from_com = points[:, :3] - com
    full = sum(
        m * (r @ r * np.eye(3) - np.outer(r, r)) for m, r in zip(mass, from_com, strict=True)
    )
    six = tuple(float(full[k]) for k in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)))
    return float(mass.sum()), tuple(map(float, com)), six


@given(clouds)
@settings(max_examples=200, deadline=None)
def test_pseudo_inertia_is_the_integral_it_stands_for(cloud: list[tuple[float, ...]]) -> None:
    """Any cloud of point masses is a body, and its pseudo-inertia is the sum of m r r^T."""
    points = np.array(cloud)
    mass, com, six = body(points)
    check_inertia(mass, com, six, "cloud")
    ones = np.column_stack([points[:, :3], np.ones(len(points))])
    direct = (ones * points[:, 3:]).T @ ones
    assert np.abs(pseudo_inertia(mass, com, six) - direct).max() < 1e-15 * max(1.0, mass)


def test_pseudo_inertia_and_tensor_are_two_forms_of_one_thing() -> None:
    points = np.random.default_rng(4).uniform(0.01, 0.1, (6, 4))
    mass, com, six = body(points)
    back = from_pseudo_inertia(pseudo_inertia(mass, com, six))
    assert back[0] == pytest.approx(mass)
    assert np.allclose(back[1], com)
    assert np.allclose(back[2], six, rtol=1e-9)


def test_the_erratum_prints_one_diagonal_entry_three_times() -> None:
    """With it even the thin rod of Appendix A-1 gets mass away from its own line."""
    m, length = 0.03, 0.045
    rod = pseudo_inertia(m, (-length / 2, 0, 0), rod_inertia(m, length, 0.0))
    appendix = np.zeros((4, 4))
    appendix[0, 0], appendix[3, 3] = m * length**2 / 3, m
    appendix[0, 3] = appendix[3, 0] = -m * length / 2
    assert np.allclose(rod, appendix, atol=1e-20)
    # About the frame's origin: Ixx = 0, Iyy = Izz = m l^2 / 3.
    as_printed = (-0.0 + 2 * m * length**2 / 3) / 2
    assert as_printed == pytest.approx(rod[0, 0])
    assert rod[1, 1] == 0.0 != as_printed


def test_the_finger_is_the_one_described() -> None:
    finger = load_arm("finger")
    assert finger.joints == ("abduction", "flexion", "middle", "tip")
    assert [round(k.a_m * 1e3, 9) for k in finger.links] == [0, 45, 30, 22]
    assert [round(k.mass_kg * 1e3, 9) for k in finger.links] == [0, 30, 18, 10]
    assert {k.damping_n_m_s for k in finger.links} == {0.002}
    degrees = [
        (round(math.degrees(k.low_rad)), round(math.degrees(k.high_rad))) for k in finger.links
    ]
    assert degrees == [(-20, 20)] + [(-20, 70)] * 3
    # Straight and level; gravity along the abduction axis's negative direction.
    assert np.allclose(tip_position(finger, [0, 0, 0, 0]), [0.097, 0, 0])
    assert np.allclose(tip_position(finger, [math.pi / 2, 0, 0, 0]), [0, 0.097, 0])
    assert np.allclose(tip_position(finger, [0, math.pi / 2, 0, 0]), [0, 0, -0.097])
    hold = dyn.gravity_torque(finger, [0, 0, 0, 0])
    assert hold[0] == 0.0
    weight = 9.80665 * (0.030 * 0.0225 + 0.018 * 0.060 + 0.010 * 0.086)
    assert hold[1] == pytest.approx(-weight)
    rod = tensor(finger.links[3].inertia_kg_m2)
    assert rod[0, 0] == pytest.approx(0.010 * 0.006**2 / 2)
    assert rod[2, 2] == pytest.approx(0.010 * (3 * 0.006**2 + 0.022**2) / 12)


def test_jacobian_is_the_tip_s_derivative() -> None:
    finger = load_arm("finger")
    q = np.array([0.1, 0.4, -0.2, 0.7])
    for k in range(4):
        step = 1e-6 * np.eye(4)[k]
        slope = (tip_position(finger, q + step) - tip_position(finger, q - step)) / 2e-6
        assert np.allclose(tip_jacobian(finger, q)[:, k], slope, atol=1e-9)


def test_all_shipped_arms_load() -> None:
    assert shipped_names("links") == ["finger", "forearm", "planar2", "planar3"]
    for name in shipped_names("links"):
        assert load_arm(name).name == name


def test_appendix_a2_has_four_misprints() -> None:
    found = {(d.torque, d.factor): (d.printed, d.derived) for d in differences()}
    s = SYMBOLS
    m1, m2, l1, lg1, lg2 = (s[k] for k in ("m1", "m2", "l1", "lg1", "lg2"))
    apart = s["theta2"] - s["theta1"]
    cos, sin = sympy.cos(apart), sympy.sin(apart)

    def same(pair: tuple[Any, Any], printed: Any, derived: Any) -> bool:
        return sympy.expand(pair[0] - printed) == 0 and sympy.expand(pair[1] - derived) == 0

    # m1 l1^2 for m2 l1^2, and a coupling that belongs to theta2'' with lg2, not lg2^2.
    inertia = m1 * lg1**2 + s["I1"]
    assert same(
        found.pop((1, "theta1dd")),
        inertia + m1 * l1**2 + m2 * l1 * lg2**2 * cos,
        inertia + m2 * l1**2,
    )
    assert same(found.pop((1, "theta2dd")), 0, m2 * l1 * lg2 * cos)
    # Centrifugal: cosine for sine.
    assert same(found.pop((1, "theta2d**2")), -m2 * l1 * lg2 * cos, -m2 * l1 * lg2 * sin)
    # The square of the wrong rate.
    assert same(found.pop((2, "theta1d**2")), 0, m2 * l1 * lg2 * sin)
    assert same(found.pop((2, "theta2d**2")), m2 * l1 * lg2 * sin, 0)
    assert not found


def test_the_derived_two_links_are_a_system_and_the_printed_are_none() -> None:
    """D must be symmetric: what theta2'' does to torque 1, theta1'' does to torque 2."""

    def coupling(pair: tuple[Any, Any]) -> Any:
        first, second = map(sympy.expand, pair)
        return first.coeff(SYMBOLS["theta2dd"]) - second.coeff(SYMBOLS["theta1dd"])

    assert coupling(derived_equations()) == 0
    assert coupling(printed_equations()) != 0


def test_the_derived_two_links_agree_with_the_arm_in_numbers() -> None:
    arm = load_arm("planar2")
    q, qd, qdd = np.random.default_rng(3).uniform(-3, 3, (3, 2))
    first, second = dyn.inverse_dynamics(arm, q, qd, qdd)
    a, b = arm.links
    values = {"m1": a.mass_kg, "m2": b.mass_kg, "l1": a.a_m, "lg1": a.a_m / 2, "lg2": b.a_m / 2}
    values |= {"I1": a.inertia_kg_m2[2], "I2": b.inertia_kg_m2[2], "g": 9.80665}
    for name, pair in (("theta{}", q), ("theta{}d", qd), ("theta{}dd", qdd)):
        values |= {name.format(1): pair[0], name.format(2): pair[0] + pair[1]}
    ours = [float(t.subs(values)) for t in derived_equations()]
    assert ours == pytest.approx([first - second, second], rel=1e-12)


def table(**changes: Any) -> dict[str, Any]:
    link = {"joint": "knee", "a_mm": 100.0, "mass_g": 20.0, "rod_diameter_mm": 5.0} | changes
    return {
        "name": "leg",
        "gravity_m_s2": [0, -9.8, 0],
        "link": [{k: v for k, v in link.items() if v is not None}],
    }


FULL = {"rod_diameter_mm": None, "com_mm": [-50, 0, 0]}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"mass_g": -5.0}, r"link 1 \(knee\): negative mass, mass_g = -5.0"),
        ({"mass_g": "5"}, r"mass_g = '5' is a str; expected a number"),
        ({"mass_g": math.nan}, "mass_g = nan is out of range"),
        ({"mass_g": None}, "mass_g is missing"),
        ({"a_mm": 1e9}, r"a_mm = 1000000000.0 is out of range; allowed -10000 to 10000"),
        ({"lenght_mm": 3}, "unknown key 'lenght_mm'; known keys"),
        ({"alpha_degs": 3}, "unknown key 'alpha_degs'; did you mean alpha_deg"),
        ({"rod_diameter_mm": None}, "a link with mass needs rod_diameter_mm, or com_mm"),
        ({"com_mm": [0, 0, 0]}, "com_mm contradict rod_diameter_mm"),
        (
            FULL | {"inertia_g_mm2": [1, 1, 5, 0, 0, 0]},
            "not a valid inertia: principal moments 1, 1, 5 g mm2; one moment cannot be larger",
        ),
        (
            FULL | {"inertia_g_mm2": [5, 5, 5, 9, 0, 0]},
            "not a valid inertia: .* one of them negative",
        ),
        (FULL | {"inertia_g_mm2": [5, 5, 5]}, "expected a list of 6 numbers"),
        ({"range_deg": [70, -20]}, "its range must increase"),
        ({"joint": 3}, "joint = 3; expected letters, digits and _"),
        ({"damping_n_m_s": -1}, "damping_n_m_s = -1 is out of range"),
    ],
)
def test_a_bad_link_is_refused_by_name(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(LinkError, match=message):
        load_arm(table(**changes))


def test_a_bad_arm_is_refused(tmp_path: Path) -> None:
    good = table()
    with pytest.raises(LinkError, match="more than one joint has the name 'knee'"):
        load_arm(good | {"link": good["link"] * 2})
    with pytest.raises(LinkError, match="gravity_m_s2 is missing"):
        load_arm({k: v for k, v in good.items() if k != "gravity_m_s2"})
    with pytest.raises(LinkError, match=r"expected 1 to 100 tables \[\[link\]\]"):
        load_arm(good | {"link": []})
    with pytest.raises(LinkError, match=r"arm 'fingr': neither a file nor shipped; did you mean f"):
        load_arm("fingr")
    with pytest.raises(LinkError, match=r"none\.toml: cannot be read"):
        load_arm(tmp_path / "none.toml")
    (tmp_path / "bad.toml").write_text("name = ")
    with pytest.raises(LinkError, match=r"bad\.toml: not valid TOML"):
        load_arm(tmp_path / "bad.toml")


def test_a_body_without_mass_has_no_inertia() -> None:
    with pytest.raises(LinkError, match="an inertia without mass"):
        Link("knee", 0.1, inertia_kg_m2=(1e-6, 1e-6, 1e-6, 0.0, 0.0, 0.0))
    with pytest.raises(LinkError, match="negative mass, -5 g"):
        Link.rod("knee", 0.1, -0.005)


def test_an_unknown_joint_is_named_with_what_there_is() -> None:
    finger = load_arm("finger")
    with pytest.raises(LinkError, match="unknown joint 'flexon'; did you mean 'flexion'"):
        finger.joint("flexon")
    with pytest.raises(LinkError, match="it has abduction, flexion, middle, tip"):
        finger.with_link("wheel", mass_kg=1.0)
    with pytest.raises(LinkError, match="no field 'mass'"):
        finger.with_link("tip", mass=1.0)
    assert finger.joint("tip") == 3


def test_an_arm_without_links_is_none() -> None:
    with pytest.raises(LinkError, match="has no links"):
        Arm("empty", ())
