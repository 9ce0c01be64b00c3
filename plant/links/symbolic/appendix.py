"""Appendix A-2 of the thesis: the two-link equations as printed, and as they have to read.

The appendix counts both angles from the horizontal and its torques are those of these angles. The
arm here counts each joint from the link before: theta1 = q1, theta2 = q1 + q2, and the virtual work
of both must agree, so the torques are tau1 - tau2 and tau2. Only after this change of variables can
the thesis's program (which counts like the arm here) give the appendix's equations.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import sympy

from plant.links.arm import Arm, Link
from plant.links.inertia import rod_inertia
from plant.links.symbolic.lagrange import derive

SYMBOLS: dict[str, Any] = {
    name: sympy.Symbol(name)
    for name in (
        *("m1", "m2", "l1", "lg1", "lg2", "I1", "I2", "g"),
        *("theta1", "theta2", "theta1d", "theta2d", "theta1dd", "theta2dd"),
    )
}
"""The appendix's symbols; d and dd mark first and second derivatives by time."""

_PRINTED = (
    "(m1*lg1**2 + I1 + m1*l1**2)*theta1dd + m2*l1*lg2**2*cos(theta2 - theta1)*theta1dd"
    " - m2*l1*lg2*cos(theta2 - theta1)*theta2d**2 + (m1*lg1 + m2*l1)*g*cos(theta1)",
    "m2*l1*lg2*cos(theta2 - theta1)*theta1dd + (m2*lg2**2 + I2)*theta2dd"
    " + m2*l1*lg2*sin(theta2 - theta1)*theta2d**2 + m2*lg2*g*cos(theta2)",
)


@dataclass(frozen=True)
class Difference:
    """What one torque has in front of one factor, as printed and as derived."""

    torque: int
    factor: str
    printed: Any
    derived: Any


def printed_equations() -> tuple[Any, Any]:
    """The two torques as Appendix A-2 prints them."""
    first, second = (sympy.sympify(text, locals=SYMBOLS) for text in _PRINTED)
    return first, second


def derived_equations() -> tuple[Any, Any]:
    """The two torques as Lagrange's equations give them, in the appendix's angles and symbols."""
    e = derive(_two_links())
    s = SYMBOLS
    change = {
        **dict(zip(e.q, (s["theta1"], s["theta2"] - s["theta1"]), strict=True)),
        **dict(zip(e.qd, (s["theta1d"], s["theta2d"] - s["theta1d"]), strict=True)),
        **dict(zip(e.qdd, (s["theta1dd"], s["theta2dd"] - s["theta1dd"]), strict=True)),
        sympy.Symbol("Izz1"): s["I1"],
        sympy.Symbol("Izz2"): s["I2"],
    }
    torque = [
        sympy.Add(
            *(d * a for d, a in zip(e.inertia[i], e.qdd, strict=True)),
            e.coriolis[i],
            e.gravity[i],
        ).subs(change, simultaneous=True)
        for i in range(2)
    ]
    return sympy.expand(torque[0] - torque[1]), sympy.expand(torque[1])


def differences() -> list[Difference]:
    """Where print and derivation differ, factor by factor."""
    found = []
    factors = [SYMBOLS["theta1dd"], SYMBOLS["theta2dd"], "theta1d**2", "theta2d**2", "g"]
    for number, pair in enumerate(zip(printed_equations(), derived_equations(), strict=True), 1):
        for factor in map(sympy.sympify, factors):
            old, new = (sympy.expand(side).coeff(factor) for side in pair)
            if sympy.expand(old - new) != 0:
                found.append(Difference(number, str(factor), old, new))
    return found


def _two_links() -> Arm:
    """Any two thin rods: only which of their numbers are zero matters."""
    return Arm(
        "appendix",
        tuple(
            Link(name, 1.0, mass_kg=1.0, com_m=(-0.5, 0.0, 0.0), inertia_kg_m2=rod_inertia(1, 1, 0))
            for name in ("first", "second")
        ),
    )
