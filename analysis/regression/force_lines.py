"""Straight lines through settled points: force against pressure, coefficients against length.

This is the black-box model of the thesis (section 4.9). At each length, force = gradient *
pressure + intercept over a pressure region (Equation 4-32, Table C-9). Gradient and intercept are
then straight lines in length (Equations 4-34 and 4-35).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

import numpy as np
import numpy.typing as npt

from analysis.regression.least_squares import Line
from daq.calibration import Calibration
from plant.arrays import Array

if TYPE_CHECKING:
    import pandas as pd

THESIS_REGION_KPA = (150.0, 600.0)
"""Section 4.8.1: from 150 to 600 kPa the force is nearly linear in pressure."""

THESIS_DIGITS = 3
"""Significant digits of Table C-9, from which Equations 4-34 and 4-35 were computed."""


@dataclass(frozen=True)
class Fit:
    """Least-squares straight line y = slope * x + intercept.

    ``u_slope`` and ``u_intercept`` are standard errors from the scatter about the line (NaN for
    two points), ``sd`` is the scatter, ``r2`` is between 0 and 1.
    """

    slope: float
    intercept: float
    u_slope: float
    u_intercept: float
    r2: float
    sd: float
    n: int


@dataclass(frozen=True)
class LengthLine:
    """Force against pressure at one held length (Equation 4-32), N and kPa.

    ``u_*_fit`` come from the scatter about the line. ``u_*_cal`` come from zero and gain of the
    pressure and force calibrations; they do not decrease with the number of points (NaN if
    unknown). ``down_minus_up_n`` is the mean force at falling pressure minus that at rising
    pressure, at the same set pressures within the region (NaN without both).
    """

    length_mm: float
    set_length_mm: float
    temperature_c: float
    n: int
    gradient_n_per_kpa: float
    u_gradient_fit: float
    u_gradient_cal: float
    intercept_n: float
    u_intercept_fit: float
    u_intercept_cal: float
    r2: float
    sd_n: float
    down_minus_up_n: float


@dataclass(frozen=True)
class LengthLaw:
    """Gradient (Equation 4-34) and intercept (Equation 4-35) as straight lines in length."""

    gradient: Fit
    intercept: Fit
    digits: int | None


def fit_line(x: Array, y: Array) -> Fit | None:
    """Ordinary least squares, shapes (n,); None with fewer than two different x."""
    n = len(x)
    if n < 2 or float(np.ptp(x)) == 0.0:
        return None
    x_mean, y_mean = float(x.mean()), float(y.mean())
    dx, dy = x - x_mean, y - y_mean
    sxx, syy = float(dx @ dx), float(dy @ dy)
    slope = float(dx @ dy) / sxx
    intercept = y_mean - slope * x_mean
    residual = dy - slope * dx
    sse = float(residual @ residual)
    variance = sse / (n - 2) if n > 2 else math.nan
    return Fit(
        slope=slope,
        intercept=intercept,
        u_slope=math.sqrt(variance / sxx) if n > 2 else math.nan,
        u_intercept=math.sqrt(variance * (1.0 / n + x_mean**2 / sxx)) if n > 2 else math.nan,
        r2=1.0 - sse / syy if syy > 0 else math.nan,
        sd=math.sqrt(variance) if n > 2 else math.nan,
        n=n,
    )


def to_significant(value: float, digits: int) -> float:
    """The value rounded to this number of significant digits."""
    return float(f"{value:.{digits}g}") if math.isfinite(value) else value


def length_groups(table: pd.DataFrame) -> list[tuple[float, float, pd.DataFrame]]:
    """Rows grouped by held length and temperature: (length, temperature, rows).

    Groups are formed by the set length, or by the measured length to 0.01 mm if there is no set
    length. Temperatures are separated, to 1 degC, only if the table spans more than 2 degC.
    """
    length = table["set_length_mm"].fillna(table["length_mm"].round(2))
    temperature = table["temperature_c"].astype(float)
    spread = float(temperature.max() - temperature.min()) if temperature.notna().any() else 0.0
    by_degree = temperature.round(0) if spread > 2.0 else temperature * 0.0
    keys = [length.rename("length"), by_degree.fillna(-1e9).rename("temperature")]
    groups = []
    for key, rows in table.groupby(keys, sort=True):
        length_key, _ = cast(tuple[float, float], key)
        groups.append((float(length_key), _mean(rows["temperature_c"]), rows))
    return groups


def nominal_kpa(table: pd.DataFrame) -> pd.Series:
    """The set pressure of each row, or the measured pressure to 1 kPa if there is none."""
    return table["set_pressure_kpa"].fillna(table["pressure_kpa"].round(0)).astype(float)


def coldest(table: pd.DataFrame) -> pd.DataFrame:
    """The rows at the lowest temperature (to 2 degC), if the table spans several."""
    temperature = table["temperature_c"].astype(float)
    if not temperature.max() - temperature.min() > 2.0:
        return table
    return table[temperature < temperature.min() + 2.0]


def per_length(
    table: pd.DataFrame,
    region_kpa: tuple[float, float] = THESIS_REGION_KPA,
    calibrations: Mapping[str, Calibration] | None = None,
) -> list[LengthLine]:
    """Fit force = gradient * pressure + intercept at each length over a pressure region.

    A point with a set pressure belongs to the region by that: 149.8 kPa measured at a set-point
    of 150 kPa is inside. Lengths with fewer than two different pressures are left out.

    Args:
        table: settled points from ``analysis.reduction.points``.
        region_kpa: lowest and highest pressure, both included.
        calibrations: by quantity (``pressure_kpa``, ``force_n``), for ``u_*_cal``.
    """
    lines = []
    for length_key, temperature_c, rows in length_groups(table):
        nominal = rows["set_pressure_kpa"].fillna(rows["pressure_kpa"])
        usable = rows["pressure_kpa"].notna() & rows["force_n"].notna()
        inside = rows[usable & nominal.between(*region_kpa)]
        pressure = inside["pressure_kpa"].to_numpy(dtype=np.float64)
        force = inside["force_n"].to_numpy(dtype=np.float64)
        fit = fit_line(pressure, force)
        if fit is None:
            continue
        u_gradient_cal, u_intercept_cal = calibration_share(pressure, force, calibrations or {})
        measured_mm = _mean(inside["length_mm"])
        lines.append(
            LengthLine(
                length_mm=measured_mm if math.isfinite(measured_mm) else length_key,
                set_length_mm=_mean(inside["set_length_mm"]),
                temperature_c=temperature_c,
                n=fit.n,
                gradient_n_per_kpa=fit.slope,
                u_gradient_fit=fit.u_slope,
                u_gradient_cal=u_gradient_cal,
                intercept_n=fit.intercept,
                u_intercept_fit=fit.u_intercept,
                u_intercept_cal=u_intercept_cal,
                r2=fit.r2,
                sd_n=fit.sd,
                down_minus_up_n=_down_minus_up(inside),
            )
        )
    return lines


def covered_kpa(table: pd.DataFrame, region_kpa: tuple[float, float]) -> tuple[float, float]:
    """Lowest and highest set pressure of the points in a region; the region if there are none."""
    nominal = nominal_kpa(table)
    inside = nominal[nominal.between(*region_kpa)]
    return (float(inside.min()), float(inside.max())) if len(inside) else region_kpa


def against_length(lines: list[LengthLine], digits: int | None = None) -> LengthLaw | None:
    """Second stage: gradient and intercept against length (Equations 4-34 and 4-35).

    Args:
        lines: first stage, of one temperature.
        digits: round gradient and intercept to this number of significant digits first. The
            thesis used the rounded values: Equation 4-34 prints -0.426, which follows from Table
            C-9; the unrounded coefficients give -0.425.

    Returns:
        The two lines, or None with fewer than three lengths.
    """
    if len(lines) < 3:
        return None

    def column(name: str) -> Array:
        values = [float(getattr(line, name)) for line in lines]
        if digits is not None and name != "length_mm":
            values = [to_significant(value, digits) for value in values]
        return np.array(values, dtype=np.float64)

    gradient = fit_line(column("length_mm"), column("gradient_n_per_kpa"))
    intercept = fit_line(column("length_mm"), column("intercept_n"))
    if gradient is None or intercept is None:
        return None
    return LengthLaw(gradient=gradient, intercept=intercept, digits=digits)


def calibration_share(
    x: Array,
    y: Array,
    calibrations: Mapping[str, Calibration],
    names: tuple[str, str] = ("pressure_kpa", "force_n"),
) -> tuple[float, float]:
    """Uncertainty of slope and intercept due to zero and gain of the calibrations.

    Args:
        x, y: the points of the line, shapes (n,).
        calibrations: by quantity.
        names: quantities of x and y.

    Returns:
        Standard uncertainties of slope and intercept; NaN if a calibration is not known.
    """
    base = fit_line(x, y)
    if base is None or not set(names) <= set(calibrations):
        return math.nan, math.nan
    x_cal, y_cal = (calibrations[name] for name in names)
    shifted = [
        (x + x_cal.u_offset, y),
        (x + x_cal.u_gain * (x - x_cal.offset), y),
        (x, y + y_cal.u_offset),
        (x, y + y_cal.u_gain * (y - y_cal.offset)),
    ]
    slope = intercept = 0.0
    for x_1, y_1 in shifted:
        moved = fit_line(x_1, y_1)
        if moved is not None:
            slope = math.hypot(slope, moved.slope - base.slope)
            intercept = math.hypot(intercept, moved.intercept - base.intercept)
    return slope, intercept


def line_uncertainty(
    line: Line,
    x: npt.ArrayLike,
    y: npt.ArrayLike,
    calibrations: Mapping[str, Calibration],
    names: tuple[str, str] = ("pressure_kpa", "force_n"),
) -> tuple[float, float]:
    """Standard uncertainties of slope and intercept, from scatter and known calibrations.

    Args:
        line: least squares through x and y, shapes (n,), without pairs that contain NaN.
        x, y, calibrations, names: as for :func:`calibration_share`.
    """
    points = np.column_stack([np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)])
    points = points[np.isfinite(points).all(axis=1)]
    shares = calibration_share(points[:, 0], points[:, 1], calibrations, names)
    slope, intercept = (0.0 if math.isnan(share) else share for share in shares)
    return math.hypot(line.u_slope, slope), math.hypot(line.u_intercept, intercept)


def _down_minus_up(rows: pd.DataFrame) -> float:
    """Mean over set pressures of the force at falling minus that at rising pressure."""
    by_pressure = rows.assign(at=nominal_kpa(rows))
    means = by_pressure.groupby(["at", "direction"])["force_n"].mean().unstack()
    if "up" not in means or "down" not in means:
        return math.nan
    difference = (means["down"] - means["up"]).dropna()
    return _mean(difference)


def _mean(values: pd.Series) -> float:
    finite = values.astype(float).dropna()
    return float(finite.mean()) if len(finite) else math.nan
