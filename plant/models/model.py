"""A model: a force law with values, units, bounds and a domain of validity."""

from __future__ import annotations

import dataclasses
import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from plant.arrays import Array
from plant.errors import PlantError
from plant.models.law import History, Law, static_force
from plant.models.uncertainty import Covariance
from plant.models.units import to_si

AXES = (("pressure_kpa", 1e3), ("length_mm", 1e-3), ("temperature_c", 1.0))
Outside = Literal["warn", "raise", "ignore"]


class OutsideDomain(UserWarning):
    """A model was used outside the range of the data it was fitted to."""


@dataclass(frozen=True)
class Parameter:
    """One parameter in its own unit; `sd` is its standard uncertainty from a fit, or None."""

    name: str
    unit: str
    value: float
    low: float
    high: float
    meaning: str = ""
    fixed: bool = False
    sd: float | None = None

    @property
    def to_si(self) -> float:
        """Factor from the parameter's unit into SI."""
        return to_si(self.unit)


@dataclass(frozen=True)
class Domain:
    """Ranges of the data that the values come from, both ends included."""

    pressure_kpa: tuple[float, float]
    length_mm: tuple[float, float]
    temperature_c: tuple[float, float]


@dataclass(frozen=True)
class Geometry:
    """Measured dimensions of a muscle: length and inner diameter, slack and without pressure.

    They give the gas volume. The force does not: a law of force has constants of its own, in which
    friction, membrane and ends are included.
    """

    rest_length_mm: float
    diameter_mm: float

    @property
    def volume_m3(self) -> float:
        """Gas volume at the rest length, a cylinder."""
        return math.pi / 4.0 * (self.diameter_mm * 1e-3) ** 2 * self.rest_length_mm * 1e-3


@dataclass(frozen=True)
class Model:
    """A law with its values and their origin; immutable.

    Attributes:
        name: name on the command line.
        title: description in one line.
        equations: equation numbers in the thesis, if any.
        source: paper or section.
        parameters: in the law's order.
        domain: of the data that the values come from.
        version: of the file format and the law; raised when a meaning changes.
        data: source of the data of the fit; `data_sha256` is its hash.
        notes: remarks for the user.
        geometry: measured dimensions of the muscle, or None.
        covariance: of the fitted parameters, or None.
        noise_n: scatter of a force reading, 1 sd, or None; see `plant.fitting.misfit`.
        model_error_n: size of the systematic error of the law within the domain, or None.
    """

    name: str
    title: str
    law: Law
    parameters: tuple[Parameter, ...]
    domain: Domain
    equations: tuple[str, ...] = ()
    source: str = ""
    version: int = 1
    data: str = ""
    data_sha256: str = ""
    notes: tuple[str, ...] = ()
    geometry: Geometry | None = None
    covariance: Covariance | None = None
    noise_n: float | None = None
    model_error_n: float | None = None

    @property
    def q(self) -> Array:
        """Values in SI, in the law's order."""
        return np.array([p.value * p.to_si for p in self.parameters], dtype=np.float64)

    @property
    def values(self) -> dict[str, float]:
        """Values in the parameters' own units."""
        return {p.name: p.value for p in self.parameters}

    def parameter(self, name: str) -> Parameter:
        """A parameter by name. Raises `PlantError` if unknown."""
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        raise PlantError(
            f"model {self.name}: no parameter {name!r}; "
            f"it has {', '.join(p.name for p in self.parameters)}"
        )

    def with_values(self, values: Mapping[str, float]) -> Model:
        """A copy with some values replaced, in the parameters' own units.

        It has no uncertainties: those belong to the values of the fit.
        Raises `PlantError` for an unknown name or a value that is not finite.
        """
        for name, value in values.items():
            self.parameter(name)
            if not np.isfinite(value):
                raise PlantError(f"model {self.name}: {name} = {value!r} is not a number")
        changed = tuple(
            dataclasses.replace(p, value=float(values.get(p.name, p.value)), sd=None)
            for p in self.parameters
        )
        return dataclasses.replace(
            self, parameters=changed, covariance=None, noise_n=None, model_error_n=None
        )

    def with_q(self, q: Array) -> Model:
        """A copy with all values replaced, in SI."""
        pairs = zip(self.parameters, q, strict=True)
        return self.with_values({p.name: float(v) / p.to_si for p, v in pairs})

    def force(
        self,
        pressure_pa: npt.ArrayLike,
        length_m: npt.ArrayLike,
        temperature_c: npt.ArrayLike = 21.0,
        path: History | None = None,
        outside: Outside = "warn",
    ) -> Array:
        """Force in N; arguments broadcast against each other.

        For a law with memory the order of the points is their history.
        Raises `PlantError` where the law has no value (for example beyond the length of the braid),
        and outside the domain if `outside` is "raise"; "warn" issues `OutsideDomain`.
        """
        p, length, t = self._inputs(pressure_pa, length_m, temperature_c, outside)
        q, shape = self.q, p.shape
        p, length, t = p.ravel(), length.ravel(), t.ravel()
        with np.errstate(invalid="ignore", divide="ignore"):
            if self.law.memory:
                out = self.law.force(q, p, length, t, path)
            else:
                out = static_force(self.law, q, p, length, t)
        if not np.isfinite(np.sum(out)):
            self._refuse(p, length, out)
        return out.reshape(shape)

    def dforce_dp(
        self,
        pressure_pa: npt.ArrayLike,
        length_m: npt.ArrayLike,
        temperature_c: npt.ArrayLike = 21.0,
    ) -> Array:
        """Partial derivative by pressure in N/Pa."""
        return self._slopes(pressure_pa, length_m, temperature_c)[0]

    def dforce_dl(
        self,
        pressure_pa: npt.ArrayLike,
        length_m: npt.ArrayLike,
        temperature_c: npt.ArrayLike = 21.0,
    ) -> Array:
        """Partial derivative by length in N/m: the stiffness at constant pressure."""
        return self._slopes(pressure_pa, length_m, temperature_c)[1]

    def volume(
        self,
        length_m: npt.ArrayLike,
        at_length_m: float | None = None,
        at_volume_m3: float | None = None,
    ) -> Array:
        """Gas volume in m3 consistent with the force: V = V_0 - integral of f dL.

        `at_volume_m3` is the volume at the length `at_length_m`; default: that of the measured
        geometry. A fit to force gives the change of the volume, never the volume itself. Raises
        `PlantError` for a model that is not of the form F = p f(L) + g(L), or without a volume.
        """
        length = np.asarray(length_m, dtype=np.float64)
        q = self.q
        if at_length_m is None or at_volume_m3 is None:
            if self.geometry is None:
                raise PlantError(
                    f"model {self.name}: a fit to force gives no gas volume; state the rest length "
                    "and the diameter of the muscle"
                )
            at_length_m = self.geometry.rest_length_mm * 1e-3
            at_volume_m3 = self.geometry.volume_m3
        zero = self.law.swept(q, np.array([at_length_m]))[0]
        return np.asarray(self.law.swept(q, length) - zero + at_volume_m3)

    def dvolume_dl(self, length_m: npt.ArrayLike) -> Array:
        """dV/dL = -f in m2. Raises as `volume` does."""
        return np.asarray(-self.law.arm(self.q, np.asarray(length_m, dtype=np.float64)))

    def outside(
        self,
        pressure_pa: npt.ArrayLike,
        length_m: npt.ArrayLike,
        temperature_c: npt.ArrayLike = 21.0,
    ) -> str:
        """Text that lists the inputs outside the domain; empty if there are none."""
        found = []
        values = (pressure_pa, length_m, temperature_c)
        for (axis, factor), given in zip(AXES, values, strict=True):
            low, high = getattr(self.domain, axis)
            array = np.asarray(given, dtype=np.float64)
            if not array.size:
                continue
            least, most = float(array.min()) / factor, float(array.max()) / factor
            slack = 1e-9 * max(abs(low), abs(high))
            if least < low - slack or most > high + slack:
                found.append(f"{axis} {least:g} to {most:g}, known {low:g} to {high:g}")
        return "; ".join(found)

    def _inputs(
        self, p: npt.ArrayLike, length: npt.ArrayLike, t: npt.ArrayLike, outside: Outside
    ) -> tuple[Array, Array, Array]:
        if outside != "ignore" and (exceeded := self.outside(p, length, t)):
            text = f"model {self.name} is used outside its domain: {exceeded}"
            if outside == "raise":
                raise PlantError(text + "; fit it to data from there first")
            warnings.warn(text, OutsideDomain, stacklevel=4)
        arrays = [np.asarray(a, dtype=np.float64) for a in (p, length, t)]
        shaped = np.broadcast_arrays(*arrays)
        return shaped[0], shaped[1], shaped[2]

    def _slopes(
        self, pressure_pa: npt.ArrayLike, length_m: npt.ArrayLike, temperature_c: npt.ArrayLike
    ) -> tuple[Array, Array, Array]:
        p, length, t = self._inputs(pressure_pa, length_m, temperature_c, "warn")
        found = self.law.slopes(self.q, p.ravel(), length.ravel(), t.ravel())
        return found[0].reshape(p.shape), found[1].reshape(p.shape), found[2].reshape(p.shape)

    def _refuse(self, p: Array, length: Array, out: Array) -> None:
        bad = int(np.flatnonzero(~np.isfinite(out))[0])
        raise PlantError(
            f"model {self.name} has no value at {p[bad] / 1e3:g} kPa and {length[bad] * 1e3:g} mm "
            f"with {', '.join(f'{k} = {v:g}' for k, v in self.values.items())}: "
            "the geometry does not exist there, or an input is not a number"
        )
