"""A surface: force in N in a table over pressure and length, on a grid or scattered."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from scipy.interpolate import CloughTocher2DInterpolator, RectBivariateSpline
from scipy.spatial import Delaunay, QhullError

from gap.data.tables import numbers, read_table, unit_check
from gap.simulators.description import Description
from gap.simulators.external import StaticExternal
from plant.arrays import Array
from plant.constants import nominal

MARGIN = 0.05
"""How far beyond the table a point may lie, as a part of the table's half extent: a sensor's zero
moves points by so much. There the surface goes on in a straight line."""
_COLUMNS = ("pressure_kpa", "length_mm", "force_n")


class Surface(StaticExternal):
    """Splines on a grid, or cubic patches on triangles (Clough and Tocher) between points."""

    def __init__(self, about: Description) -> None:
        super().__init__(about)
        if self._parameters:
            raise about.error("parameters", "a surface has no parameters; use a Python function")
        name = about.text("table")
        path = about.file(name)
        if not path.is_file():
            raise about.error("table", f"no such file {name}", "it is relative to this file")
        table = read_table(path, _COLUMNS, ())
        unit_check(table, _COLUMNS)
        columns = [numbers(table, column, nominal()) for column in _COLUMNS]
        for column, value in zip(_COLUMNS, columns, strict=True):
            empty = np.flatnonzero(~np.isfinite(value))
            if len(empty):
                raise table.error(int(empty[0]), column, "is empty")
        points = np.stack(columns[:2], axis=1)
        if len(np.unique(points, axis=0)) < len(points):
            raise about.error("table", f"{name} holds a point twice", "average its rows")
        self._low, high = points.min(axis=0), points.max(axis=0)
        self._extent = np.where(high > self._low, high - self._low, 1.0)
        unit = (points - self._low) / self._extent
        try:
            self._hull = Delaunay(unit)
        except (QhullError, ValueError):
            raise about.error(
                "table", f"{name} needs several pressures at several lengths, not on one line"
            ) from None
        self._centre = unit.mean(axis=0)
        self._inside = _interpolator(unit, columns[2])

    def _law(
        self, pressure_kpa: Array, length_mm: Array, values: Mapping[str, float], trial: str
    ) -> Array:
        asked = np.stack([pressure_kpa.ravel(), length_mm.ravel()], axis=1)
        unit = (asked - self._low) / self._extent
        force = self._inside(unit)
        outside = ~self._within(unit)
        if outside.any():
            # In a straight line along the ray from the middle of the table.
            ray = unit[outside] - self._centre
            near, inner = ray / (1.0 + MARGIN), ray / (1.0 + MARGIN) ** 2
            at_near, at_inner = (self._inside(self._centre + part) for part in (near, inner))
            known = self._within(self._centre + near)
            gone_on = at_near + (at_near - at_inner) * (1.0 + MARGIN)
            force[outside] = np.where(known, gone_on, np.nan)
        return np.asarray(force.reshape(pressure_kpa.shape))

    def _within(self, unit: Array) -> np.ndarray:
        return np.asarray(self._hull.find_simplex(unit, tol=1e-9) >= 0)

    def _outside(self) -> str:
        return "the table must cover the measured pressures and lengths"


def _interpolator(unit: Array, force: Array) -> Callable[[Array], Array]:
    """Force by points of shape (n, 2)."""
    x, y = np.unique(unit[:, 0]), np.unique(unit[:, 1])
    if len(x) * len(y) == len(unit):
        grid = np.empty((len(x), len(y)))
        grid[np.searchsorted(x, unit[:, 0]), np.searchsorted(y, unit[:, 1])] = force
        spline = RectBivariateSpline(x, y, grid, kx=min(3, len(x) - 1), ky=min(3, len(y) - 1))
        return lambda at: np.asarray(spline.ev(at[:, 0], at[:, 1]))
    patches = CloughTocher2DInterpolator(unit, force)
    return lambda at: np.asarray(patches(at))
