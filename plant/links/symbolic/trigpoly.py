"""Exact polynomials in sines and cosines of joint angles, in a canonical form.

Sines and cosines of sums of joint angles, with coefficients polynomial in the arm's parameters:
    sum over v of  a(v) cos(v . q) + b(v) sin(v . q),   v integers.
A product is converted to such a sum immediately, so sin^2 + cos^2 becomes 1 and cos(q2) cos(q3) -
sin(q2) sin(q3) becomes cos(q2 + q3) without a search. No `simplify` is needed.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import sympy

Waves = tuple[int, ...]
"""Factors of the joint angles in one argument."""


class TrigPoly:
    """One such sum. `terms` maps v to (a, b); the first nonzero element of v is positive."""

    __slots__ = ("terms",)

    def __init__(self, terms: dict[Waves, tuple[Any, Any]]) -> None:
        self.terms = {v: (a, b) for v, (a, b) in terms.items() if a or b}

    @classmethod
    def constant(cls, value: Any, degrees: int) -> TrigPoly:
        """A value without angles."""
        return cls({(0,) * degrees: (value, value * 0)})

    def __bool__(self) -> bool:
        return bool(self.terms)

    def __add__(self, other: TrigPoly) -> TrigPoly:
        return total((self, other))

    def __mul__(self, other: TrigPoly) -> TrigPoly:
        out: dict[Waves, tuple[Any, Any]] = {}
        for v, (a, b) in self.terms.items():
            for w, (c, d) in other.terms.items():
                # Twice the product; halved once at the end.
                ac, bd, ad, bc = a * c, b * d, a * d, b * c
                _join(out, tuple(x + y for x, y in zip(v, w, strict=True)), ac - bd, ad + bc)
                _join(out, tuple(x - y for x, y in zip(v, w, strict=True)), ac + bd, bc - ad)
        return TrigPoly({v: (a.quo_ground(2), b.quo_ground(2)) for v, (a, b) in out.items()})

    def derivative(self, joint: int) -> TrigPoly:
        """With respect to one joint's angle."""
        return TrigPoly({v: (b * v[joint], a * -v[joint]) for v, (a, b) in self.terms.items()})

    def scaled(self, factor: Any) -> TrigPoly:
        """Product with a number or a parameter of the same ring."""
        return TrigPoly({v: (a * factor, b * factor) for v, (a, b) in self.terms.items()})

    def expression(self, angles: tuple[Any, ...]) -> Any:
        """As a SymPy expression of the given angles."""
        parts = []
        for v in sorted(self.terms, key=lambda w: (sum(map(abs, w)), w)):
            a, b = self.terms[v]
            argument = sympy.Add(*(k * angle for k, angle in zip(v, angles, strict=True)))
            if a:
                parts.append(_factored(a) * sympy.cos(argument))
            if b:
                parts.append(_factored(b) * sympy.sin(argument))
        return sympy.Add(*parts)


def total(parts: Iterable[TrigPoly]) -> TrigPoly:
    """Sum of one or more polynomials."""
    out: dict[Waves, tuple[Any, Any]] = {}
    for part in parts:
        for v, (a, b) in part.terms.items():
            c, d = out.get(v, (0, 0))
            out[v] = (a + c, b + d)
    return TrigPoly(out)


def _join(out: dict[Waves, tuple[Any, Any]], v: Waves, a: Any, b: Any) -> None:
    """Add a cos + b sin of v, with v normalized to a positive first nonzero element."""
    lead = next((x for x in v if x), 0)
    if lead < 0:
        v, b = tuple(-x for x in v), -b
    elif lead == 0:
        b = b * 0
    c, d = out.get(v, (0, 0))
    out[v] = (a + c, b + d)


def _factored(polynomial: Any) -> Any:
    """As an expression, with common factors and sign in front."""
    content, rest = polynomial.primitive()
    if all(number < 0 for number in rest.coeffs()):
        content, rest = -content, -rest
    shared = tuple(min(powers) for powers in zip(*rest.monoms(), strict=True))
    monomial = polynomial.ring({shared: polynomial.ring.domain.one})
    return sympy.Mul(sympy.Rational(content), monomial.as_expr(), rest.quo(monomial).as_expr())
