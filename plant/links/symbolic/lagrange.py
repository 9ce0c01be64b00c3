"""Symbolic Lagrange-Euler equations of an arm, from section 2.2 of the thesis.

D comes from the traces of equation 2-18, h from its derivatives (Christoffel symbols, equivalent to
the traces of equation 2-20), c from the potential. The printed equations have three errors: 2-18
has J(k) for J(j); the second case of U(ijk) has i >= j >= i for i >= j >= k; and c has U(ij) for
U(ji).

Needs SymPy (`pip install 'pamrig[symbolic]'`). Only nonzero parameters of the arm become symbols,
so the equations of a planar arm are as short as in a textbook.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import sympy
from sympy.polys.rings import ring

from plant.links.arm import Arm
from plant.links.symbolic.trigpoly import TrigPoly, total

Matrix = list[list[TrigPoly]]


@dataclass(frozen=True)
class Equations:
    """D q'' + h + c + b q' = torque as SymPy expressions, rows in tuples.

    `parameters` maps each symbol to its value (SI); `christoffel[i][k][m]` is the factor of
    q'(k) q'(m) in h(i), h(ikm) in the thesis.
    """

    name: str
    joints: tuple[str, ...]
    q: tuple[Any, ...]
    qd: tuple[Any, ...]
    qdd: tuple[Any, ...]
    torque: tuple[Any, ...]
    parameters: dict[str, float]
    inertia: tuple[tuple[Any, ...], ...]
    christoffel: tuple[tuple[tuple[Any, ...], ...], ...]
    coriolis: tuple[Any, ...]
    gravity: tuple[Any, ...]
    damping: tuple[Any, ...]

    @property
    def degrees(self) -> int:
        """Number of joints."""
        return len(self.q)

    def inertia_rate(self) -> tuple[tuple[Any, ...], ...]:
        """dD/dt: the derivatives of each entry by the angles, times the rates."""
        return tuple(
            tuple(
                sympy.Add(*(sympy.diff(d, q) * qd for q, qd in zip(self.q, self.qd, strict=True)))
                for d in row
            )
            for row in self.inertia
        )

    def coriolis_matrix(self) -> tuple[tuple[Any, ...], ...]:
        """C with C q' = h, from Christoffel symbols."""
        return tuple(
            tuple(sympy.Add(*(g * qd for g, qd in zip(row, self.qd, strict=True))) for row in block)
            for block in self.christoffel
        )


class _Parameters:
    """The parameters of an arm as symbols of one polynomial ring; zeros stay numbers."""

    def __init__(self, arm: Arm) -> None:
        self.values: dict[str, float] = {}
        for i, link in enumerate(arm.links, 1):
            self._note(f"l{i}", link.a_m)
            self._note(f"d{i}", link.d_m)
            for name, value in zip((f"ca{i}", f"sa{i}"), link.twist, strict=True):
                if value not in (-1.0, 0.0, 1.0):
                    self._note(name, value)
            if link.mass_kg:
                self._note(f"m{i}", link.mass_kg)
                # Measured from the joint, as in textbooks and in Appendix A-2 of the thesis.
                self._note(f"lg{i}", link.a_m + link.com_m[0])
                self._note(f"yg{i}", link.com_m[1])
                self._note(f"zg{i}", link.com_m[2])
                for axes, value in zip(
                    ("xx", "yy", "zz", "xy", "xz", "yz"), link.inertia_kg_m2, strict=True
                ):
                    self._note(f"I{axes}{i}", value)
        downs = [v for v in arm.gravity_m_s2 if v]
        self.down: list[tuple[str, int]] = []
        if len(downs) == 1:
            self._note("g", abs(downs[0]))
            self.down = [("g", int(v / abs(v)) if v else 0) for v in arm.gravity_m_s2]
        else:
            for axis, v in zip("xyz", arm.gravity_m_s2, strict=True):
                self._note(f"g{axis}", v)
            self.down = [(f"g{axis}", 1) for axis in "xyz"]
        names = list(self.values) or ["unit"]
        self.ring, *generators = ring(names, sympy.QQ)
        self.of = dict(zip(names, generators, strict=True))

    def _note(self, name: str, value: float) -> None:
        if value:
            self.values[name] = value

    def __getitem__(self, name: str) -> Any:
        return self.of.get(name, self.ring.zero)

    def number(self, name: str, value: float) -> Any:
        """A cosine or sine of a twist: a symbol, or an integer."""
        return self.of.get(name, self.ring(round(value)))


@functools.lru_cache(maxsize=32)
def derive(arm: Arm) -> Equations:
    """The equations of an arm; results are cached."""
    n = arm.degrees
    p = _Parameters(arm)
    transforms = _transforms(arm, p)
    d: list[list[TrigPoly]] = [[TrigPoly({}) for _ in range(n)] for _ in range(n)]
    potential = [TrigPoly({})]
    for j in range(n):
        body = _pseudo_inertia(arm, j, p)
        if not any(entry for row in body for entry in row):
            continue
        # U(jk) = dA(j)/dq(k), only the three nonzero rows.
        u = [_differentiate(transforms[j], k) for k in range(j + 1)]
        for k in range(j + 1):
            left = _times(u[k], body)
            for i in range(k + 1):
                d[i][k] = d[i][k] + _trace(left, u[i])
        for axis, (name, sign) in enumerate(p.down):
            if sign and name in p.of:
                row = transforms[j][axis]
                moment = total(row[c].scaled(body[c][3]) for c in range(4) if body[c][3])
                potential.append(moment.scaled(p[name] * -sign))
    for k in range(n):
        for i in range(k):
            d[k][i] = d[i][k]
    gradient = [[[d[i][k].derivative(m) for m in range(n)] for k in range(n)] for i in range(n)]
    half = sympy.QQ(1, 2)
    christoffel = [
        [
            [
                total((gradient[i][k][m], gradient[i][m][k], gradient[k][m][i].scaled(-1))).scaled(
                    half
                )
                for m in range(n)
            ]
            for k in range(n)
        ]
        for i in range(n)
    ]
    gravity = total(potential)
    return _as_expressions(arm, p, d, christoffel, [gravity.derivative(i) for i in range(n)])


def _transforms(arm: Arm, p: _Parameters) -> list[Matrix]:
    """Upper three rows of 0A(i) for each link, as polynomials."""
    n = arm.degrees
    one = p.ring.one

    def const(value: Any) -> TrigPoly:
        return TrigPoly.constant(value, n)

    out: list[Matrix] = []
    for i, link in enumerate(arm.links):
        v = tuple(int(k == i) for k in range(n))
        c, s = TrigPoly({v: (one, one * 0)}), TrigPoly({v: (one * 0, one)})
        ca = p.number(f"ca{i + 1}", link.twist[0])
        sa = p.number(f"sa{i + 1}", link.twist[1])
        a, z = p[f"l{i + 1}"], p[f"d{i + 1}"]
        zero = TrigPoly({})
        step: Matrix = [
            [c, s.scaled(-ca), s.scaled(sa), c.scaled(a)],
            [s, c.scaled(ca), c.scaled(-sa), s.scaled(a)],
            [zero, const(sa), const(ca), const(z)],
            [zero, zero, zero, const(one)],
        ]
        if not out:
            out.append(step[:3])
            continue
        padded = out[-1] + [step[3]]
        out.append(
            [
                [total(padded[r][m] * step[m][k] for m in range(4)) for k in range(4)]
                for r in range(3)
            ]
        )
    return out


def _pseudo_inertia(arm: Arm, j: int, p: _Parameters) -> list[list[Any]]:
    """J(j) of the erratum with a corrected diagonal, about the frame's origin."""
    i = j + 1
    m = p[f"m{i}"]
    com = (p[f"lg{i}"] - p[f"l{i}"], p[f"yg{i}"], p[f"zg{i}"])
    xx, yy, zz = p[f"Ixx{i}"], p[f"Iyy{i}"], p[f"Izz{i}"]
    xy, xz, yz = -p[f"Ixy{i}"], -p[f"Ixz{i}"], -p[f"Iyz{i}"]
    half = sympy.QQ(1, 2)
    second = [
        [(yy + zz - xx) * half, xy, xz],
        [xy, (xx + zz - yy) * half, yz],
        [xz, yz, (xx + yy - zz) * half],
    ]
    if not arm.links[j].mass_kg:
        return [[p.ring.zero] * 4 for _ in range(4)]
    rows = [[second[r][c] + m * com[r] * com[c] for c in range(3)] + [m * com[r]] for r in range(3)]
    return [*rows, [m * com[0], m * com[1], m * com[2], m]]


def _differentiate(matrix: Matrix, joint: int) -> Matrix:
    return [[entry.derivative(joint) for entry in row] for row in matrix]


def _times(matrix: Matrix, body: list[list[Any]]) -> Matrix:
    return [
        [total(row[m].scaled(body[m][c]) for m in range(4) if body[m][c]) for c in range(4)]
        for row in matrix
    ]


def _trace(left: Matrix, right: Matrix) -> TrigPoly:
    """Tr(left right^T)."""
    return total(
        a * b
        for row, other in zip(left, right, strict=True)
        for a, b in zip(row, other, strict=True)
        if a and b
    )


def _as_expressions(
    arm: Arm, p: _Parameters, d: Matrix, christoffel: list[list[list[TrigPoly]]], c: list[TrigPoly]
) -> Equations:
    n = arm.degrees
    numbers = range(1, n + 1)
    q, qd, qdd, torque = (
        tuple(sympy.Symbol(f"{letter}{i}") for i in numbers) for letter in ("q", "qd", "qdd", "tau")
    )
    values = dict(p.values)
    # Offsets shift the angles; they do not change the rates.
    angles = []
    for i, link in enumerate(arm.links):
        if link.offset_rad:
            values[f"q0{i + 1}"] = link.offset_rad
        angles.append(q[i] + (sympy.Symbol(f"q0{i + 1}") if link.offset_rad else 0))
    damping = []
    for i, link in enumerate(arm.links):
        if link.damping_n_m_s:
            values[f"b{i + 1}"] = link.damping_n_m_s
        damping.append(sympy.Symbol(f"b{i + 1}") * qd[i] if link.damping_n_m_s else sympy.S.Zero)
    at = tuple(angles)
    h = []
    for i in range(n):
        parts = []
        for k in range(n):
            for m in range(k, n):
                factor = christoffel[i][k][m].scaled(1 if k == m else 2)
                parts.append(factor.expression(at) * qd[k] * qd[m])
        h.append(sympy.Add(*parts))
    inertia = tuple(tuple(entry.expression(at) for entry in row) for row in d)
    gravity = tuple(entry.expression(at) for entry in c)
    # Some moments of a planar arm do not appear in its equations.
    used = {
        str(s) for row in (*inertia, gravity, damping) for value in row for s in value.free_symbols
    }
    return Equations(
        arm.name,
        arm.joints,
        q,
        qd,
        qdd,
        torque,
        {name: value for name, value in values.items() if name in used},
        inertia,
        tuple(tuple(tuple(g.expression(at) for g in row) for row in b) for b in christoffel),
        tuple(h),
        gravity,
        tuple(damping),
    )
