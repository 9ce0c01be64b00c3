"""Appendix A-2 of the thesis: the two-link equations as printed, and corrected.

The appendix measures both angles from the horizontal, and its torques belong to these angles. The
arm here measures each joint angle from the previous link: theta1 = q1, theta2 = q1 + q2. Equal
virtual work gives the torques tau1 - tau2 and tau2. With this change of variables the program of
the thesis (same angles as the arm here) gives the equations of the appendix.
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
"""Symbols of the appendix; d and dd are first and second time derivatives."""


@dataclass(frozen=True)
class Difference:
    """Coefficient of one factor in one torque, as printed and as derived."""

    torque: int
    factor: str
    printed: Any
    derived: Any


def printed_equations() -> tuple[Any, Any]:
    """The two torques as Appendix A-2 prints them."""
    m1, m2, l1, lg1, lg2, i1, i2, g = (
        SYMBOLS[name] for name in ("m1", "m2", "l1", "lg1", "lg2", "I1", "I2", "g")
    )
    theta1, theta2 = SYMBOLS["theta1"], SYMBOLS["theta2"]
    theta1dd, theta2d, theta2dd = (SYMBOLS[name] for name in ("theta1dd", "theta2d", "theta2dd"))
    across, along = sympy.sin(theta2 - theta1), sympy.cos(theta2 - theta1)
    return (
        (m1 * lg1**2 + i1 + m1 * l1**2) * theta1dd
        + m2 * l1 * lg2**2 * along * theta1dd
        - m2 * l1 * lg2 * along * theta2d**2
        + (m1 * lg1 + m2 * l1) * g * sympy.cos(theta1),
        m2 * l1 * lg2 * along * theta1dd
        + (m2 * lg2**2 + i2) * theta2dd
        + m2 * l1 * lg2 * across * theta2d**2
        + m2 * lg2 * g * sympy.cos(theta2),
    )


def derived_equations() -> tuple[Any, Any]:
    """The two torques from Lagrange's equations, in the angles and symbols of the appendix."""
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
            *(d * a for d, a in zip(e.inertia[i], e.qdd, strict=True)), e.coriolis[i], e.gravity[i]
        ).subs(change, simultaneous=True)
        for i in range(2)
    ]
    return sympy.expand(torque[0] - torque[1]), sympy.expand(torque[1])


def differences() -> list[Difference]:
    """Differences between print and derivation, factor by factor."""
    found = []
    s = SYMBOLS
    factors = [s["theta1dd"], s["theta2dd"], s["theta1d"] ** 2, s["theta2d"] ** 2, s["g"]]
    for number, pair in enumerate(zip(printed_equations(), derived_equations(), strict=True), 1):
        for factor in factors:
            old, new = (sympy.expand(side).coeff(factor) for side in pair)
            if sympy.expand(old - new) != 0:
                found.append(Difference(number, str(factor), old, new))
    return found


def _two_links() -> Arm:
    """Two thin rods; only the zeros among their parameters matter."""
    return Arm(
        "appendix",
        tuple(
            Link(name, 1.0, mass_kg=1.0, com_m=(-0.5, 0.0, 0.0), inertia_kg_m2=rod_inertia(1, 1, 0))
            for name in ("first", "second")
        ),
    )
