"""An arm's equations as text, LaTeX or Python source."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import sympy

from plant.errors import LinkError
from plant.links.symbolic.lagrange import Equations
from plant.links.symbolic.sourcecode import as_python
from plant.links.symbolic.statespace import dynamics_steps, solution_steps

FORMS = ("text", "latex", "python")


def printed(equations: Equations, form: str = "text") -> str:
    """The equations in one of `FORMS`, with a final newline. `LinkError` for another form."""
    makers: dict[str, Callable[[Equations], str]] = {
        "text": as_text,
        "latex": as_latex,
        "python": as_python,
    }
    if form not in makers:
        raise LinkError(f"cannot print as {form!r}; choose one of {', '.join(FORMS)}")
    return makers[form](equations)


def as_text(equations: Equations) -> str:
    """Plain text, one equation per line."""
    n = equations.degrees
    joints = ", ".join(f"q{i + 1} {name}" for i, name in enumerate(equations.joints))
    damped = " + b q'" if any(equations.damping) else ""
    lines = [
        f"{equations.name}: {joints}",
        f"D(q) q'' + h(q, q') + c(q){damped} = tau    (SI: rad, s, N m; qd is q', qdd is q'')",
    ]
    lines += ["", "Inertia D, symmetric"]
    lines += [
        f"  D{i + 1}_{k + 1} = {equations.inertia[i][k]}" for i in range(n) for k in range(i, n)
    ]
    lines += ["", "Coriolis and centrifugal h"]
    lines += [f"  h{i + 1} = {value}" for i, value in enumerate(equations.coriolis)]
    lines += ["", "Gravity c"]
    lines += [f"  c{i + 1} = {value}" for i, value in enumerate(equations.gravity)]
    rest = "tau - h - c" + damped.replace("+", "-")
    lines += ["", f"State space: x = (q, q'), x' = (q', D^-1 ({rest}))"]
    steps = dynamics_steps(equations)[-n:] + solution_steps(equations)
    lines += [f"  {name} = {value}" for name, value in steps]
    lines += ["", "Parameters, SI"]
    lines += [f"  {name} = {value:.9g}" for name, value in equations.parameters.items()]
    return "\n".join(lines) + "\n"


def as_latex(equations: Equations) -> str:
    """One `align*` environment per part, for a document with amsmath."""
    n = equations.degrees

    def aligned(title: str, rows: list[tuple[str, Any]]) -> list[str]:
        body = [rf"  {name} &= {_latex(value)} \\" for name, value in rows]
        return [f"% {title}", r"\begin{align*}", *body, r"\end{align*}"]

    numbers = range(n)
    joints = ", ".join(f"$q_{{{i + 1}}}$ {name}" for i, name in enumerate(equations.joints))
    lines = [f"% {equations.name}: {joints}"]
    damped = r" + b\,\dot q" if any(equations.damping) else ""
    lines += [rf"\[ D(q)\,\ddot q + h(q, \dot q) + c(q){damped} = \tau \]"]
    lines += aligned(
        "Inertia",
        [(f"D_{{{i + 1},{k + 1}}}", equations.inertia[i][k]) for i in numbers for k in range(i, n)],
    )
    lines += aligned(
        "Coriolis and centrifugal", [(f"h_{{{i + 1}}}", equations.coriolis[i]) for i in numbers]
    )
    lines += aligned("Gravity", [(f"c_{{{i + 1}}}", equations.gravity[i]) for i in numbers])
    steps = dynamics_steps(equations)[-n:] + solution_steps(equations)
    lines += aligned(
        "State space: accelerations, from top to bottom",
        [(_latex(name), value) for name, value in steps],
    )
    lines += [f"% {name} = {value:.9g} (SI)" for name, value in equations.parameters.items()]
    return "\n".join(lines) + "\n"


def _latex(value: Any) -> str:
    names = {symbol: _latex_name(str(symbol)) for symbol in value.free_symbols}
    return str(sympy.latex(value, symbol_names=names))


def _latex_name(name: str) -> str:
    r"""q1 -> q_{1}, qd1 -> \dot q_{1}, lg2 -> l_{g2}, Ixx2 -> I_{xx2}, D1_2 -> D_{1,2}."""
    match = re.fullmatch(r"([A-Za-z]+?)(\d*)(?:_(\d+))?", name)
    assert match is not None
    word, first, second = match.groups()
    index = f"{first},{second}" if second else first
    special = {"q": "q", "qd": r"\dot q", "qdd": r"\ddot q", "tau": r"\tau"}
    if word in special:
        return f"{special[word]}_{{{index}}}"
    return f"{word[0]}_{{{word[1:]}{index}}}" if word[1:] or index else word
