"""Sums of products of powers: the thesis's black boxes and quasi-static models."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from plant.arrays import Array
from plant.models.law import Law, Past, Slopes

LOW_TOP_PA = 125e3
HIGH_BOTTOM_PA = 150e3
"""The thesis fits 0 to 125 and 150 to 600 kPa separately; it has no data in between."""


@dataclass(frozen=True)
class Term:
    """(p - offset)^i L^j T^k."""

    pressure: int = 0
    length: int = 0
    temperature: int = 0
    offset_pa: float = 0.0

    def value(self, p: Array, length: Array, t: Array) -> Array | float:
        """The product, shape (n,), or 1 for the constant."""
        out: Array | float = 1.0
        for base, power in ((length, self.length), (t, self.temperature)):
            for _ in range(power):
                out = base if isinstance(out, float) else out * base
        if self.pressure:
            shifted = p - self.offset_pa if self.offset_pa else p
            for _ in range(self.pressure):
                out = shifted if isinstance(out, float) else out * shifted
        return out

    def slope(self, by: str) -> tuple[float, Term]:
        """Derivative by "pressure", "length" or "temperature": a factor and a term."""
        power = int(getattr(self, by))
        if not power:
            return 0.0, self
        powers = {n: getattr(self, n) for n in ("pressure", "length", "temperature")}
        powers[by] = power - 1
        return float(power), Term(**powers, offset_pa=self.offset_pa)


class TermLaw(Law):
    """Sum of parameter times term; linear, so it is fitted without starting values."""

    linear = True
    terms: tuple[Term, ...]

    def __init__(self, **terms: Term) -> None:
        self.names = tuple(terms)
        self.terms = tuple(terms.values())
        self.parameters = self.names  # type: ignore[misc]
        self.uses_temperature = any(t.temperature for t in self.terms)  # type: ignore[misc]
        self.separable = not self.uses_temperature and all(  # type: ignore[misc]
            t.pressure <= 1 for t in self.terms
        )

    def force(self, q: Array, p: Array, length: Array, t: Array, path: Past = None) -> Array:
        """The sum."""
        out = np.zeros_like(p)
        for c, term in zip(q, self.terms, strict=True):
            out += c * term.value(p, length, t)
        return out

    def slopes(self, q: Array, p: Array, length: Array, t: Array, path: Past = None) -> Slopes:
        """The sum's derivatives."""
        found = []
        for by in ("pressure", "length", "temperature"):
            out = np.zeros_like(p)
            for c, term in zip(q, self.terms, strict=True):
                factor, derived = term.slope(by)
                if factor:
                    out += c * factor * derived.value(p, length, t)
            found.append(out)
        return found[0], found[1], found[2]

    def jacobian(self, q: Array, p: Array, length: Array, t: Array, path: Past = None) -> Array:
        """The terms."""
        return np.stack([np.broadcast_to(term.value(p, length, t), p.shape) for term in self.terms])

    def arm(self, q: Array, length: Array) -> Array:
        """Sum of the terms with pressure, divided by pressure."""
        return self._polynomial(q, length, 1, lambda power: (1.0, power))

    def passive(self, q: Array, length: Array) -> Array:
        """Sum of the terms without pressure, and of the constant part of offset terms."""
        return self._polynomial(q, length, 0, lambda power: (1.0, power))

    def swept(self, q: Array, length: Array) -> Array:
        """Minus the antiderivative of `arm`."""
        return self._polynomial(q, length, 1, lambda power: (-1.0 / (power + 1), power + 1))

    def _polynomial(self, q: Array, length: Array, pressure: int, of: object) -> Array:
        if not self.separable:
            raise self._not_separable()
        out = np.zeros_like(length)
        for c, term in zip(q, self.terms, strict=True):
            factor, power = of(term.length)  # type: ignore[operator]
            if term.pressure == pressure:
                out += c * factor * length**power
            elif pressure == 0 and term.offset_pa:
                out -= c * term.offset_pa * factor * length**power
        return out


class Blend(Law):
    """One law up to 125 kPa, another from 150 kPa, blended linearly between them.

    The thesis switches at 125 or 150 kPa. A jump there would disturb a controller, so the gap
    without data is interpolated. At the pressures of the thesis the blend equals its model.
    """

    linear = True

    def __init__(self, low: TermLaw, high: TermLaw) -> None:
        self.low, self.high = low, high
        names = [f"low_{n}" for n in low.parameters] + [f"high_{n}" for n in high.parameters]
        self.parameters = tuple(names)  # type: ignore[misc]
        self.uses_temperature = low.uses_temperature or high.uses_temperature  # type: ignore[misc]

    def _parts(self, q: Array) -> tuple[Array, Array]:
        split = len(self.low.parameters)
        return q[:split], q[split:]

    def _weight(self, p: Array) -> Array:
        weight = (p - LOW_TOP_PA) * (1.0 / (HIGH_BOTTOM_PA - LOW_TOP_PA))
        return np.asarray(np.clip(weight, 0.0, 1.0, out=weight))

    def force(self, q: Array, p: Array, length: Array, t: Array, path: Past = None) -> Array:
        """(1 - w) low + w high."""
        a, b = self._parts(q)
        low = self.low.force(a, p, length, t)
        return np.asarray(low + self._weight(p) * (self.high.force(b, p, length, t) - low))

    def slopes(self, q: Array, p: Array, length: Array, t: Array, path: Past = None) -> Slopes:
        """Slopes of both laws, blended, plus the slope of the weight."""
        a, b = self._parts(q)
        w = self._weight(p)
        low, high = self.low.slopes(a, p, length, t), self.high.slopes(b, p, length, t)
        inside = (p > LOW_TOP_PA) & (p < HIGH_BOTTOM_PA)
        jump = (self.high.force(b, p, length, t) - self.low.force(a, p, length, t)) * inside
        by_p, by_l, by_t = (x + w * (y - x) for x, y in zip(low, high, strict=True))
        return by_p + jump / (HIGH_BOTTOM_PA - LOW_TOP_PA), by_l, by_t

    def jacobian(self, q: Array, p: Array, length: Array, t: Array, path: Past = None) -> Array:
        """Both laws' terms, weighted."""
        a, b = self._parts(q)
        w = self._weight(p)
        low, high = self.low.jacobian(a, p, length, t), self.high.jacobian(b, p, length, t)
        return np.concatenate([(1.0 - w) * low, w * high])


BLACK_BOX_LOW = TermLaw(
    k1_cube=Term(1, 3), k2_product=Term(1, 1), k3_pressure=Term(1), k4_length=Term(0, 1), c=Term()
)
"""Equation 4-41."""

BLACK_BOX_HIGH = TermLaw(k1_product=Term(1, 1), k3_pressure=Term(1), k2_length=Term(0, 1), c=Term())
"""Equation 4-36; K1 to K3 as in the headings of Table 4-1."""

BLACK_BOX_LOW_T = TermLaw(
    k1_cube=Term(1, 3),
    k1_cube_t=Term(1, 3, 1),
    k2_product=Term(1, 1),
    k2_product_t=Term(1, 1, 1),
    k3_pressure=Term(1),
    k3_pressure_t=Term(1, 0, 1),
    k4_length=Term(0, 1),
    k4_length_t=Term(0, 1, 1),
    c=Term(),
    c_t=Term(0, 0, 1),
)
"""Equation 4-58."""

BLACK_BOX_HIGH_T = TermLaw(
    k1_product=Term(1, 1),
    k1_product_t=Term(1, 1, 1),
    k2_length=Term(0, 1),
    k3_pressure=Term(1),
    k3_pressure_t=Term(1, 0, 1),
    c=Term(),
)
"""Equation 4-51."""

QUASI_STATIC_LOW = TermLaw(c=Term(), ke_length=Term(0, 1), kb_pressure=Term(1))
"""Equations 4-59 to 4-62 as fitted by Full-regression C-8; the fit determines the signs."""

QUASI_STATIC_HIGH = TermLaw(
    c=Term(), kd_product=Term(1, 1), kp_excess=Term(1, offset_pa=LOW_TOP_PA)
)
"""Section 4.13.2 as fitted by Full-regression C-9, P_th = 125 kPa."""

BLACK_BOX = Blend(BLACK_BOX_LOW, BLACK_BOX_HIGH)
BLACK_BOX_T = Blend(BLACK_BOX_LOW_T, BLACK_BOX_HIGH_T)
QUASI_STATIC = Blend(QUASI_STATIC_LOW, QUASI_STATIC_HIGH)
