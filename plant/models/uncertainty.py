"""What a fitted model states about itself: covariance, noise and systematic error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from plant import tomlfile
from plant.arrays import Array
from plant.errors import PlantError

ROUNDING = 1e-9
"""Asymmetry and negative eigenvalues up to this, relative to the standard deviations, are
rounding."""
SD_AGREES = 1e-6
"""Relative difference allowed between a stated sd and the covariance."""


@dataclass(frozen=True)
class Covariance:
    """Covariance of the fitted parameters in their own units; rows and columns as `names`."""

    names: tuple[str, ...]
    matrix: tuple[tuple[float, ...], ...]

    @property
    def array(self) -> Array:
        """The matrix, shape (k, k)."""
        return np.array(self.matrix, dtype=np.float64)

    def sd(self, name: str) -> float:
        """Standard deviation of a parameter; 0 for one that was not fitted."""
        if name not in self.names:
            return 0.0
        at = self.names.index(name)
        return float(np.sqrt(self.matrix[at][at]))


def read_covariance(
    table: Mapping[str, Any], parameters: Sequence[str], stated_sd: Mapping[str, float], origin: str
) -> Covariance:
    """The table `[covariance]` of a model file.

    Args:
        table: keys `names` and `matrix`.
        parameters: names of the law's parameters.
        stated_sd: standard deviations stated with the parameters; they must agree.
        origin: for messages.

    Raises:
        PlantError: an unknown key or parameter, or a matrix that is not square, not symmetric, not
            positive, or contradicts a stated sd.
    """
    where = f"{origin} [covariance]"
    tomlfile.check_keys(table, ("names", "matrix"), where)
    names, rows = table.get("names"), table.get("matrix")
    if not isinstance(names, list) or not names or not all(isinstance(n, str) for n in names):
        raise PlantError(f"{where}: names = {names!r}; expected a list of parameters")
    for k, name in enumerate(names):
        if name not in parameters:
            raise PlantError(f"{where}: no parameter {name!r}; known: {', '.join(parameters)}")
        if name in names[:k]:
            raise PlantError(f"{where}: {name!r} occurs twice in names; name each parameter once")
    matrix = _square(rows, len(names), where)
    sd = _checked_sd(matrix, names, where)
    for name, value in zip(names, sd, strict=True):
        stated = stated_sd.get(name)
        if stated is not None and abs(stated - value) > SD_AGREES * value:
            raise PlantError(
                f"{where}: the root of the variance of {name} is {value:g}, and its sd is "
                f"{stated:g}; correct one of them"
            )
    return Covariance(tuple(names), tuple(tuple(float(x) for x in row) for row in matrix))


def _square(rows: object, size: int, where: str) -> Array:
    rows = rows if isinstance(rows, list) else [rows]
    for row in rows:
        if not isinstance(row, list) or len(row) != size or len(rows) != size:
            raise PlantError(f"{where}: matrix has to be {size} rows of {size} numbers, as names")
        for value in row:
            if isinstance(value, bool) or not isinstance(value, (int, float)):
                raise PlantError(f"{where}: matrix has {value!r}; expected numbers")
    matrix = np.array(rows, dtype=np.float64)
    if not np.all(np.isfinite(matrix)):
        raise PlantError(f"{where}: matrix has a value that is not finite; fit the model again")
    return matrix


def _checked_sd(matrix: Array, names: Sequence[str], where: str) -> Array:
    variance = np.diag(matrix)
    if not np.all(variance > 0):
        at = int(np.flatnonzero(~(variance > 0))[0])
        raise PlantError(
            f"{where}: the variance of {names[at]} is {variance[at]:g}; it has to be positive"
        )
    sd = np.sqrt(variance)
    correlation = matrix / sd / sd[:, None]
    apart = np.abs(correlation - correlation.T)
    if np.max(apart) > ROUNDING:
        row, column = divmod(int(np.argmax(apart)), len(names))
        raise PlantError(
            f"{where}: matrix is not symmetric at {names[row]}, {names[column]}: "
            f"{matrix[row, column]:g} and {matrix[column, row]:g}"
        )
    least = float(np.linalg.eigvalsh(correlation)[0])
    if least < -ROUNDING * len(names):
        raise PlantError(
            f"{where}: matrix is not positive: an eigenvalue of its correlations is {least:.3g}; "
            "fit the model again"
        )
    return sd


def covariance_lines(covariance: Covariance) -> list[str]:
    """The table `[covariance]` as lines of TOML; `read_covariance` reads back an equal value."""
    names = ", ".join(f'"{name}"' for name in covariance.names)
    rows = [f"    [{', '.join(repr(float(x)) for x in row)}]," for row in covariance.matrix]
    return ["", "[covariance]", f"names = [{names}]", "matrix = [", *rows, "]"]
