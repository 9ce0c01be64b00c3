"""Interface of a force law: force, its slopes, its sensitivity to the parameters."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from plant.arrays import Array
from plant.errors import PlantError

Bools = npt.NDArray[np.bool_]
Slopes = tuple[Array, Array, Array]


@dataclass(frozen=True)
class History:
    """The order in which points were measured, for laws with memory.

    Attributes:
        time_s: shape (n,), increasing within each trial; None if only the order is known.
        start: shape (n,), True where a new trial starts from the vented state.
    """

    time_s: Array | None = None
    start: Bools | None = None


Past = History | None
"""History of the points, or None for laws without memory."""


class Law(ABC):
    """A formula F(p, L, T) with parameters q in SI units, temperature in degC.

    `p` is the gauge pressure in Pa, `length` the length in m, `t` the temperature in degC, all
    float64 with the same shape (n,). `q` has one number per parameter, in the order of
    `parameters`. `plant.models.model.Model` checks the inputs. F > 0 pulls the ends together.
    """

    parameters: ClassVar[tuple[str, ...]]
    linear: ClassVar[bool] = False
    """The force is linear in the parameters."""
    separable: ClassVar[bool] = False
    """The force is p f(L) + g(L): `arm`, `passive` and `swept` exist."""
    memory: ClassVar[bool] = False
    """The force depends on the path to a point."""
    uses_temperature: ClassVar[bool] = False

    @abstractmethod
    def force(self, q: Array, p: Array, length: Array, t: Array, path: Past = None) -> Array:
        """Force in N, shape (n,)."""

    @abstractmethod
    def slopes(self, q: Array, p: Array, length: Array, t: Array, path: Past = None) -> Slopes:
        """dF/dp in N/Pa, dF/dL in N/m and dF/dT in N/K, each shape (n,)."""

    @abstractmethod
    def jacobian(self, q: Array, p: Array, length: Array, t: Array, path: Past = None) -> Array:
        """dF/dq, shape (k, n)."""

    def arm(self, q: Array, length: Array) -> Array:
        """f(L) = -dV/dL in m2 of a separable law."""
        raise self._not_separable()

    def passive(self, q: Array, length: Array) -> Array:
        """g(L) in N of a separable law."""
        raise self._not_separable()

    def swept(self, q: Array, length: Array) -> Array:
        """-integral of f dL in m3 of a separable law, up to a constant."""
        raise self._not_separable()

    def _not_separable(self) -> PlantError:
        return PlantError(
            f"{type(self).__name__} is not of the form p f(L) + g(L) and so has no volume; "
            "use the volume of the braid (chou-hannaford)"
        )


CHUNK = 16384
"""Points evaluated at a time, so that intermediate results stay in the processor's cache."""


def static_force(law: Law, q: Array, p: Array, length: Array, t: Array) -> Array:
    """Force of a law without memory, in chunks."""
    if p.size <= CHUNK:
        return law.force(q, p, length, t)
    out = np.empty(p.size)
    for at in range(0, p.size, CHUNK):
        part = slice(at, at + CHUNK)
        out[part] = law.force(q, p[part], length[part], t[part])
    return out


class SeparableLaw(Law):
    """F = p f(L) + g(L): the gas volume is V_0 - integral of f dL, without loss of work."""

    separable = True

    @abstractmethod
    def arm(self, q: Array, length: Array) -> Array:
        """f(L) in m2."""

    @abstractmethod
    def arm_slope(self, q: Array, length: Array) -> Array:
        """df/dL in m."""

    @abstractmethod
    def swept(self, q: Array, length: Array) -> Array:
        """-integral of f dL in m3, up to a constant."""

    def passive(self, q: Array, length: Array) -> Array:
        """g(L) in N; 0 by default."""
        return np.zeros_like(length)

    def passive_slope(self, q: Array, length: Array) -> Array:
        """dg/dL in N/m."""
        return np.zeros_like(length)

    def force(self, q: Array, p: Array, length: Array, t: Array, path: Past = None) -> Array:
        """F = p f(L) + g(L)."""
        return np.asarray(p * self.arm(q, length) + self.passive(q, length))

    def slopes(self, q: Array, p: Array, length: Array, t: Array, path: Past = None) -> Slopes:
        """f, p f' + g', 0."""
        slope = p * self.arm_slope(q, length) + self.passive_slope(q, length)
        return self.arm(q, length), slope, np.zeros_like(length)
