"""An arm's equations as a module of Python source."""

from __future__ import annotations

from typing import Any

import sympy

from plant.links.symbolic.lagrange import Equations
from plant.links.symbolic.statespace import Step, dynamics_steps, entry, solution_steps


def as_python(equations: Equations) -> str:
    """Functions of angles that are floats or arrays of the same shape.

    `p` are the parameters in the order of NAMES, by default those of the arm. The source needs only
    numpy, and numba can compile its functions.
    """
    n = equations.degrees
    q, qd, qdd, tau = equations.q, equations.qd, equations.qdd, equations.torque
    steps = dynamics_steps(equations)
    torque = []
    for i in range(n):
        inertial = [entry(i + 1, k + 1) * qdd[k] for k in range(n) if equations.inertia[i][k] != 0]
        h, c = sympy.Symbol(f"h{i + 1}"), sympy.Symbol(f"c{i + 1}")
        torque.append(sympy.Add(*inertial, h, c, equations.damping[i]))
    table: list[tuple[str, str, dict[str, tuple[Any, ...]], list[Step], Any]] = [
        ("inertia", "D, rows in a tuple.", {"q": q}, [], equations.inertia),
        ("coriolis", "h: Coriolis and centrifugal torques.", {"q": q, "qd": qd}, [],
         [equations.coriolis]),
        ("gravity", "c: torques that hold the arm still.", {"q": q}, [], [equations.gravity]),
        # The last n steps compute the residual torques r, which inverse dynamics does not need.
        ("inverse_dynamics", "Torques for given accelerations.", {"q": q, "qd": qd, "qdd": qdd},
         steps[:-n], [torque]),
        ("forward_dynamics", "Accelerations under given torques.", {"q": q, "qd": qd, "tau": tau},
         steps + solution_steps(equations), [qdd]),
    ]  # fmt: skip
    functions = [_function(equations, *row) for row in table]
    values = equations.parameters
    joints = ", ".join(equations.joints)
    head = [
        f'"""Equations of motion of {equations.name} ({joints}); written by pamrig links."""',
        "",
        "from numpy import cos, sin",
        "",
        "# SI: m, kg, kg m2, m/s2, rad, N m s",
        f"NAMES = {_tuple([repr(name) for name in values])}",
        f"P = {_tuple([repr(float(value)) for value in values.values()])}",
    ]
    tail = [
        "",
        "",
        "def state_space(x, tau, p=P):",
        '    """Derivative of x = (q, qd)."""',
        f"    return (*x[{n}:], *forward_dynamics(x[:{n}], x[{n}:], tau, p))",
    ]
    return "\n".join([*head, *(line for lines in functions for line in lines), *tail]) + "\n"


def _function(
    equations: Equations,
    name: str,
    doc: str,
    arguments: dict[str, tuple[Any, ...]],
    steps: list[Step],
    rows: Any,
) -> list[str]:
    """Lines of one function: unpack arguments, steps with shared subexpressions, results.

    One row of results is returned as a tuple, several rows as a tuple of tuples.
    """
    flat = [value for row in rows for value in row]
    shared, reduced = sympy.cse(
        [value for _, value in steps] + flat, sympy.numbered_symbols("s"), order="none"
    )
    done = _ordered(shared, list(zip([s for s, _ in steps], reduced, strict=False)))
    used = set().union(*(v.free_symbols for _, v in done), *(v.free_symbols for v in reduced))
    lines = ["", "", f"def {name}({', '.join(arguments)}, p=P):", f'    """{doc}"""']
    parameters = tuple(sympy.Symbol(key) for key in equations.parameters)
    for source, symbols in [*arguments.items(), ("p", parameters)]:
        # Unused arguments are unpacked into _.
        targets = [str(s) if s in used else "_" for s in symbols]
        if set(targets) - {"_"}:
            lines.append(f"    {', '.join(targets)}{',' * (len(targets) == 1)} = {source}")
    lines += [f"    {target} = {_code(value)}" for target, value in done]
    values = iter([_code(value) for value in reduced[len(steps) :]])
    results = [_tuple([next(values) for _ in row]) for row in rows]
    return [*lines, f"    return {results[0] if len(results) == 1 else _tuple(results)}"]


def _ordered(shared: list[Step], steps: list[Step]) -> list[Step]:
    """Steps in their order, each shared part as soon as its inputs are known."""
    missing = {symbol for symbol, _ in [*shared, *steps]}
    waiting = list(shared)
    out: list[Step] = []
    for step in [None, *steps]:
        if step is not None:
            out.append(step)
            missing.discard(step[0])
        ready = [True]
        while ready:
            ready = []
            for part in list(waiting):
                if not part[1].free_symbols & missing:
                    out.append(part)
                    waiting.remove(part)
                    missing.discard(part[0])
                    ready.append(True)
    return out


def _tuple(items: list[str]) -> str:
    return f"({', '.join(items)}{',' * (len(items) == 1)})"


def _code(value: Any) -> str:
    return "0.0" if value == 0 else str(sympy.pycode(value, fully_qualified_modules=False))
