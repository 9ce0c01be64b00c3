"""The equations in symbols: right, quickly derived, printed, generated, kept."""

from __future__ import annotations

import importlib
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy
from sympy.physics.mechanics import LagrangesMethod, dynamicsymbols

from links_oracles import mujoco_torque, pinocchio_torque, spatial_arm
from plant.arrays import Array
from plant.links import Arm, LinkError, load_arm
from plant.links import dynamics as dyn
from plant.links.inertia import pseudo_inertia
from plant.links.kinematics import link_matrix
from plant.links.symbolic.generated import generated, generated_source
from plant.links.symbolic.lagrange import Equations, derive
from plant.links.symbolic.printing import printed

ARMS = {
    "planar2": load_arm("planar2"),
    "planar3": load_arm("planar3"),
    "finger": load_arm("finger"),
    "skew2": spatial_arm(2, 5),
}
each_arm = pytest.mark.parametrize("arm", ARMS.values(), ids=list(ARMS))


@pytest.fixture(autouse=True)
def _own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PAMRIG_CACHE", str(tmp_path / "cache"))
    generated.cache_clear()


def states(arm: Arm, count: int = 1000) -> list[Array]:
    r = np.random.default_rng(8)
    return [r.uniform(-top, top, (count, arm.degrees)) for top in (np.pi, 20.0, 500.0)]


def off(ours: Array, theirs: Array) -> float:
    return float((np.abs(ours - theirs).max(axis=1) / np.abs(theirs).max(axis=1)).max())


@each_arm
def test_symbolic_agrees_with_compiled_pinocchio_and_mujoco(arm: Arm) -> None:
    state = states(arm)
    ours = generated(arm).inverse_dynamics(*state)
    assert off(ours, dyn.inverse_dynamics(arm, *state)) < 1e-12
    assert off(ours, mujoco_torque(arm, *state)) < 1e-12
    damping = np.array([link.damping_n_m_s for link in arm.links])
    assert off(ours, pinocchio_torque(arm, *state) + damping * state[1]) < 1e-12


@each_arm
def test_each_part_agrees_with_the_compiled_one(arm: Arm) -> None:
    q, qd, qdd = states(arm, 300)
    parts = generated(arm)
    d = dyn.inertia_matrix(arm, q)
    assert np.abs(parts.inertia_matrix(q) - d).max() < 1e-13 * np.abs(d).max()
    h, c = dyn.velocity_torque(arm, q, qd), dyn.gravity_torque(arm, q)
    assert np.abs(parts.velocity_torque(q, qd) - h).max() < 1e-12 * np.abs(h).max()
    assert np.abs(parts.gravity_torque(q) - c).max() < 1e-12 * np.abs(c).max()
    torque = dyn.inverse_dynamics(arm, q, qd, qdd)
    assert off(parts.forward_dynamics(q, qd, torque), qdd) < 1e-10
    x = np.concatenate([q[0], qd[0]])
    rates = parts.functions["state_space"](tuple(x), tuple(torque[0]))
    assert np.allclose(rates, np.concatenate([qd[0], qdd[0]]), rtol=1e-9)


@each_arm
def test_rate_of_inertia_less_twice_coriolis_is_skew_symmetric(arm: Arm) -> None:
    """D' by differentiating D; C from the compiled kernel, which knows nothing of derivatives."""
    e = derive(arm)
    numbers = list(e.parameters.values())
    arguments = [*e.q, *e.qd, *map(sympy.Symbol, e.parameters)]
    rate = sympy.lambdify(arguments, sympy.Matrix(e.inertia_rate()), cse=True)
    q, qd, _ = states(arm, 200)
    compiled = dyn.coriolis_matrix(arm, q, qd)
    for row, speed, c in zip(q, qd, compiled, strict=True):
        n = rate(*row, *speed, *numbers) - 2.0 * c
        assert np.abs(n + n.T).max() < 1e-10 * np.abs(c).max()


@each_arm
def test_the_thesis_traces_give_the_same_coriolis_factors(arm: Arm) -> None:
    """Equation 2-20 as it stands, in numbers: h(ikm) = sum of Tr(U(jkm) J(j) U(ji)^T)."""
    e = derive(arm)
    n = arm.degrees
    flat = [g for block in e.christoffel for row in block for g in row]
    function = sympy.lambdify([*e.q, *map(sympy.Symbol, e.parameters)], flat)
    turn = np.zeros((4, 4))
    turn[0, 1], turn[1, 0] = -1.0, 1.0
    for q in states(arm, 5)[0]:
        ours = np.array(function(*q, *e.parameters.values())).reshape(n, n, n)
        traces = np.zeros((n, n, n))
        a = [link_matrix(link, angle) for link, angle in zip(arm.links, q, strict=True)]

        def chain(j: int, *turned: int, a: list[Array] = a) -> Array:
            out = np.eye(4)
            for i in range(j + 1):
                for _ in range(turned.count(i)):
                    out = out @ turn
                out = out @ a[i]
            return out

        for j, link in enumerate(arm.links):
            body = pseudo_inertia(link.mass_kg, link.com_m, link.inertia_kg_m2)
            for i in range(j + 1):
                for k in range(j + 1):
                    for m in range(j + 1):
                        traces[i, k, m] += np.trace(chain(j, k, m) @ body @ chain(j, i).T)
        assert np.abs(ours - traces).max() < 1e-13 * np.abs(traces).max()


def test_sympys_own_lagrangian_gives_the_same_two_links() -> None:
    """Independent: positions and energies written by hand, SymPy's LagrangesMethod."""
    e = derive(load_arm("planar2"))
    l1, m1, lg1, i1, m2, lg2, i2, g = sympy.symbols("l1 m1 lg1 Izz1 m2 lg2 Izz2 g")
    q1, q2 = dynamicsymbols("q1 q2")
    t = dynamicsymbols._t
    elbow = sympy.Matrix([sympy.cos(q1), sympy.sin(q1)])
    wrist = sympy.Matrix([sympy.cos(q1 + q2), sympy.sin(q1 + q2)])
    first, second = lg1 * elbow, l1 * elbow + lg2 * wrist
    kinetic = (
        m1 * first.diff(t).dot(first.diff(t))
        + m2 * second.diff(t).dot(second.diff(t))
        + i1 * q1.diff(t) ** 2
        + i2 * (q1 + q2).diff(t) ** 2
    ) / 2
    method = LagrangesMethod(kinetic - g * (m1 * first[1] + m2 * second[1]), [q1, q2])
    theirs = method.form_lagranges_equations()
    back = dict(zip([q1, q2], e.q, strict=True))
    back |= dict(zip([q1.diff(t), q2.diff(t)], e.qd, strict=True))
    back |= dict(zip([q1.diff(t, 2), q2.diff(t, 2)], e.qdd, strict=True))
    for i in range(2):
        accelerated = sum(d * a for d, a in zip(e.inertia[i], e.qdd, strict=True))
        ours = accelerated + e.coriolis[i] + e.gravity[i]
        other = theirs[i]
        for old in sorted(back, key=lambda s: -str(s).count("Derivative") - str(s).count(", 2")):
            other = other.subs(old, back[old])
        assert sympy.simplify(ours - other) == 0


@pytest.mark.parametrize("gone", [1, 2, 3])
def test_in_symbols_three_links_become_two(gone: int) -> None:
    """Section 2.4: m and l of one link set to 0 leaves the other two, joint angles added."""
    three, two = derive(load_arm("planar3")), derive(load_arm("planar2"))
    kept = [k for k in (1, 2, 3) if k != gone]
    nothing = {sympy.Symbol(f"{name}{gone}"): 0 for name in ("m", "l", "lg", "Izz")}
    rename = {}
    for new, old in enumerate(kept, 1):
        for name in ("m", "l", "lg", "Izz"):
            rename[sympy.Symbol(f"{name}{new}")] = sympy.Symbol(f"{name}{old}")
    sums = {
        1: (three.q[0] + three.q[1], three.q[2]),
        2: (three.q[0], three.q[1] + three.q[2]),
        3: (three.q[0], three.q[1]),
    }[gone]
    rename |= dict(zip(two.q, sums, strict=True))
    for i, old in enumerate(kept):
        for k, other in enumerate(kept):
            shrunk = three.inertia[old - 1][other - 1].subs(nothing)
            assert sympy.expand(shrunk - two.inertia[i][k].subs(rename, simultaneous=True)) == 0
        shrunk = three.gravity[old - 1].subs(nothing)
        assert sympy.expand(shrunk - two.gravity[i].subs(rename, simultaneous=True)) == 0


def test_the_finger_is_derived_in_well_under_thirty_seconds() -> None:
    """From nothing, in a new process: SymPy's start, derivation, all three forms."""
    code = (
        "from plant.links import load_arm; from plant.links.symbolic.lagrange import derive;"
        "from plant.links.symbolic.printing import printed;"
        "e = derive(load_arm('finger')); [printed(e, f) for f in ('text', 'latex', 'python')]"
    )
    before = os.times().children_user
    subprocess.run([sys.executable, "-c", code], check=True, timeout=6000)
    assert os.times().children_user - before < 30.0


@pytest.fixture(scope="module")
def planar() -> Equations:
    return derive(load_arm("planar2"))


def test_text_reads_as_a_book_prints_it(planar: Equations) -> None:
    text = printed(planar, "text")
    assert "D2_2 = Izz2 + lg2**2*m2\n" in text
    assert "h2 = l1*lg2*m2*qd1**2*sin(q2)\n" in text
    assert "c2 = g*lg2*m2*cos(q1 + q2)\n" in text
    assert "qdd1 = -L2_1*qdd2 + r1/D1_1\n" in text


def test_latex_is_what_matplotlib_can_set(planar: Equations) -> None:
    latex = printed(planar, "latex")
    assert r"h_{2} &= l_{1} l_{g2} m_{2} \dot q_{1}^{2} \sin{\left(q_{2} \right)} \\" in latex
    assert latex.count(r"\begin{align*}") == latex.count(r"\end{align*}") == 4
    from matplotlib.mathtext import MathTextParser

    parser = MathTextParser("agg")
    rows = [line for line in latex.splitlines() if "&=" in line]
    assert len(rows) == 3 + 2 + 2 + 7
    for row in rows:
        parser.parse("$" + row.strip().removesuffix(r"\\").replace("&", "") + "$")


def test_an_unknown_form_is_refused(planar: Equations) -> None:
    with pytest.raises(LinkError, match="choose one of text, latex, python"):
        printed(planar, "maple")


def test_generated_source_is_kept_and_a_damaged_one_is_made_anew(tmp_path: Path) -> None:
    arm = load_arm("planar3")
    source = generated_source(arm)
    (kept,) = (tmp_path / "cache" / "links").iterdir()
    assert kept.read_text().startswith(source)
    # What is kept is what is used: SymPy is not asked again.
    code = (
        "import sys; from plant.links import load_arm;"
        "from plant.links.symbolic.generated import generated;"
        "print(generated(load_arm('planar3')).inverse_dynamics([0, 0, 0], [1, 2, 3], [1, 1, 1]));"
        "assert 'sympy' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=600)
    kept.write_text(kept.read_text().replace("cos", "sin", 1))
    assert generated_source(arm) == source
    assert kept.read_text().startswith(source)
    # Another arm, another file.
    generated_source(arm.with_link("third", mass_kg=0.02))
    assert len(list((tmp_path / "cache" / "links").iterdir())) == 2


def test_a_cache_that_cannot_be_written_only_costs_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("PAMRIG_CACHE", str(tmp_path / "file"))
    assert "def inertia" in generated_source(load_arm("planar2"))


def test_generated_functions_compile_with_numba(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from numba import njit

    arm = load_arm("finger")
    (tmp_path / "finger_equations.py").write_text(generated_source(arm))
    monkeypatch.syspath_prepend(tmp_path)
    source = importlib.import_module("finger_equations")
    compiled = njit(source.inverse_dynamics)
    q, qd, qdd = (x[0] for x in states(arm, 1))
    ours = np.array(compiled(tuple(q), tuple(qd), tuple(qdd)))
    theirs = dyn.inverse_dynamics(arm, q, qd, qdd)
    assert np.abs(ours - theirs).max() < 1e-12 * np.abs(theirs).max()


def same(ours: Any, theirs: Any) -> bool:
    """Tuples of tuples of numbers or arrays."""
    if isinstance(theirs, tuple):
        return len(ours) == len(theirs) and all(map(same, ours, theirs))
    return np.array_equal(ours, theirs)


@each_arm
def test_evaluated_and_run_the_source_says_the_same(
    arm: Arm, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Bit by bit, on numbers and on arrays, with the arm's parameters and with others."""
    (tmp_path / f"run_{arm.name}.py").write_text(generated_source(arm))
    monkeypatch.syspath_prepend(tmp_path)
    run = importlib.import_module(f"run_{arm.name}")
    ours = generated(arm).functions
    q, qd, tau = (tuple(x.T) for x in states(arm, 5))
    first = [tuple(float(x[0]) for x in given) for given in (q, qd, tau)]
    other = tuple(1.01 * value for value in run.P)
    for given in ((q, qd, tau), first):
        for name, count in (("inertia", 1), ("coriolis", 2), ("gravity", 1),
                            ("inverse_dynamics", 3), ("forward_dynamics", 3)):  # fmt: skip
            for p in (run.P, other):
                theirs = getattr(run, name)(*given[:count], p)
                assert same(ours[name](*given[:count], p=p), theirs)
            assert same(ours[name](*given[:count]), getattr(run, name)(*given[:count]))
    x = (*first[0], *first[1])
    assert ours["state_space"](x, first[2]) == run.state_space(x, first[2])


def test_nothing_calls_simplify() -> None:
    folder = Path(dyn.__file__).parent
    assert not [p.name for p in folder.glob("*.py") if "simplify(" in p.read_text()]
