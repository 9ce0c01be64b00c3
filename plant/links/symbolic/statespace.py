"""The equations in state-space form, symbolically solved for the accelerations.

    x = (q, q'),   x' = (q', D^-1 (torque - h - c - b q'))

D is factored as L P L^T (L with a unit diagonal, P diagonal). No pivoting is needed because D is
positive definite. The result is a list of assignments, evaluated from top to bottom, without a
numerical solver (thesis, section 2.3).
"""

from __future__ import annotations

from typing import Any

import sympy

from plant.links.symbolic.lagrange import Equations

Step = tuple[Any, Any]


def entry(i: int, k: int) -> Any:
    """Symbol of an entry of D, with indices from 1; the smaller index comes first."""
    return sympy.Symbol(f"D{min(i, k)}_{max(i, k)}")


def dynamics_steps(equations: Equations) -> list[Step]:
    """Assignments of the nonzero entries of D, of h and c, and (the last n) of r.

    r = torque - h - c - b q' = D q''.
    """
    n = equations.degrees
    steps: list[Step] = []
    for i in range(n):
        for k in range(i, n):
            if equations.inertia[i][k] != 0:
                steps.append((entry(i + 1, k + 1), equations.inertia[i][k]))
    for i in range(n):
        steps.append((sympy.Symbol(f"h{i + 1}"), equations.coriolis[i]))
        steps.append((sympy.Symbol(f"c{i + 1}"), equations.gravity[i]))
    for i in range(n):
        h, c = sympy.Symbol(f"h{i + 1}"), sympy.Symbol(f"c{i + 1}")
        rest = equations.torque[i] - h - c - equations.damping[i]
        steps.append((sympy.Symbol(f"r{i + 1}"), rest))
    return steps


def solution_steps(equations: Equations) -> list[Step]:
    """Assignments that compute the accelerations from the entries of D and r."""
    n = equations.degrees
    d = [
        [entry(i + 1, k + 1) if equations.inertia[i][k] != 0 else sympy.S.Zero for k in range(n)]
        for i in range(n)
    ]
    steps: list[Step] = []
    pivot: list[Any] = []
    lower: list[list[Any]] = [[sympy.S.Zero] * n for _ in range(n)]

    def name(symbol: str, value: Any) -> Any:
        """Assign the value to a symbol; a symbol or number is used directly."""
        if value.is_Atom:
            return value
        steps.append((sympy.Symbol(symbol), value))
        return steps[-1][0]

    for j in range(n):
        known = sympy.Add(*(lower[j][k] ** 2 * pivot[k] for k in range(j)))
        pivot.append(name(f"P{j + 1}", d[j][j] - known))
        for i in range(j + 1, n):
            known = sympy.Add(*(lower[i][k] * lower[j][k] * pivot[k] for k in range(j)))
            lower[i][j] = name(f"L{i + 1}_{j + 1}", (d[i][j] - known) / pivot[j])
    y: list[Any] = []
    for i in range(n):
        known = sympy.Add(*(lower[i][k] * y[k] for k in range(i)))
        y.append(name(f"y{i + 1}", sympy.Symbol(f"r{i + 1}") - known))
    for i in reversed(range(n)):
        known = sympy.Add(*(lower[k][i] * equations.qdd[k] for k in range(i + 1, n)))
        steps.append((equations.qdd[i], y[i] / pivot[i] - known))
    return steps
