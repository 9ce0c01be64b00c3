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
        stated = "model_error_n" in about.table
        self._between_n = 0.0 if stated else _error_between(unit, columns[2], self._hull)

    @property
    def rough_error_n(self) -> float:
        """One sd of the error between the points in N, as points left out show it; 0 if stated."""
        return self._between_n

    @property
    def notes(self) -> tuple[str, ...]:
        """What the error between the points is taken for, where nothing is stated."""
        if self._between_n < _WORTH_A_NOTE_N:
            return ()
        return (
            f"{self.about.path.name} states no model_error_n: the surface is taken to be off by "
            f"{self._between_n:.2g} N between its points, half of what it misses points by that "
            "are left out",
        )

    def _law(
        self, pressure_kpa: Array, length_mm: Array, values: Mapping[str, float], trial: str
    ) -> Array:
        asked = np.stack([pressure_kpa.ravel(), length_mm.ravel()], axis=1)
        unit = (asked - self._low) / self._extent
        force = self._inside(unit)
        outside = ~self._within(unit)
        if outside.any():
            # In a straight line along the ray from the middle of the table. What was measured must
            # lie near it; where an error of a sensor is tried, the point behind may lie far off.
            ray = unit[outside] - self._centre
            reach = np.full(len(ray), 1.0 / (1.0 + MARGIN)) if trial else self._reach(ray)
            near, inner = ray * reach[:, None], ray * reach[:, None] / (1.0 + MARGIN)
            at_near, at_inner = (self._inside(self._centre + part) for part in (near, inner))
            known = self._within(self._centre + near)
            slope = (at_near - at_inner) * (1.0 + MARGIN) / MARGIN
            force[outside] = np.where(known, at_near + slope * (1.0 / reach - 1.0), np.nan)
        return np.asarray(force.reshape(pressure_kpa.shape))

    def _reach(self, ray: Array) -> Array:
        """Share of each ray from the middle at which it leaves the table, a little inside of it."""
        low, high = np.zeros(len(ray)), np.ones(len(ray))
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            inside = self._within(self._centre + ray * middle[:, None])
            low, high = np.where(inside, middle, low), np.where(inside, high, middle)
        return np.maximum(low, _LEAST_REACH)

    def _within(self, unit: Array) -> np.ndarray:
        return np.asarray(self._hull.find_simplex(unit, tol=1e-9) >= 0)

    def _outside(self) -> str:
        return "the table must cover the measured pressures and lengths"


_HALVINGS = 14
_LEAST_REACH = 0.02
_WORTH_A_NOTE_N = 0.01
_FINER = 0.5
"""Part of the error at points that are left out that is left once they are back: where the surface
has a corner; where it is smooth, it is less."""
_MOST_LEFT_OUT = 40


def _error_between(unit: Array, force: Array, hull: Delaunay) -> float:
    """Error in N of a surface between its points, one sd, from points that are left out in turn.

    Of a grid whole lines are left out; points at its edges stay.
    """
    missed: list[Array] = []
    x, y = np.unique(unit[:, 0]), np.unique(unit[:, 1])
    if len(x) * len(y) == len(unit):
        groups = [unit[:, axis] == at for axis, line in ((0, x), (1, y)) for at in line[1:-1]]
    else:
        edge = np.unique(hull.convex_hull)
        inner = np.setdiff1d(np.arange(len(unit)), edge)
        groups = [np.arange(len(unit)) == one for one in inner]
    step = max(1, -(-len(groups) // _MOST_LEFT_OUT))
    for out in groups[::step]:
        if len(np.unique(unit[~out, 0])) < 2 or len(np.unique(unit[~out, 1])) < 2:
            continue
        missed.append(_interpolator(unit[~out], force[~out])(unit[out]) - force[out])
    known = np.concatenate(missed) if missed else np.zeros(1)
    known = known[np.isfinite(known)]
    return _FINER * float(np.sqrt(np.mean(known**2))) if len(known) else 0.0


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
