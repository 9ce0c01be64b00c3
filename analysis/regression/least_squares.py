"""Straight lines by least squares with the statistics of a regression table."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from plant.arrays import Array


@dataclass(frozen=True)
class Line:
    """``y = intercept + slope x``, ordinary least squares.

    Attributes:
        intercept, slope: coefficients.
        u_intercept, u_slope: standard errors from the scatter, n - 2 degrees of freedom.
        p_intercept, p_slope: two-sided p values of the hypothesis that they are zero.
        s: standard deviation about the line.
        r2, r2_adjusted: coefficients of determination, 0 to 1.
        ss_regression, ss_error: sums of squares.
        n: points.
    """

    intercept: float
    slope: float
    u_intercept: float
    u_slope: float
    p_intercept: float
    p_slope: float
    s: float
    r2: float
    r2_adjusted: float
    ss_regression: float
    ss_error: float
    n: int

    def at(self, x: npt.ArrayLike) -> Array:
        """Values of the line."""
        return np.asarray(self.intercept + self.slope * np.asarray(x, dtype=np.float64))

    @property
    def t_slope(self) -> float:
        """T value of the slope."""
        return self.slope / self.u_slope if self.u_slope else math.inf

    @property
    def t_intercept(self) -> float:
        """T value of the intercept."""
        return self.intercept / self.u_intercept if self.u_intercept else math.inf

    @property
    def f(self) -> float:
        """F value of the regression."""
        return self.ss_regression / (self.ss_error / (self.n - 2)) if self.ss_error else math.inf


def straight_line(x: npt.ArrayLike, y: npt.ArrayLike) -> Line | None:
    """Fit a line, shapes (n,). Pairs that contain NaN are left out.

    Returns:
        None with fewer than three points, or if all have the same x.
    """
    from scipy.special import stdtr

    all_x, all_y = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    good = np.isfinite(all_x) & np.isfinite(all_y)
    xs, ys = all_x[good], all_y[good]
    n = len(xs)
    if n < 3 or float(np.ptp(xs)) == 0.0:
        return None
    dx, dy = xs - xs.mean(), ys - ys.mean()
    sxx, syy = float(dx @ dx), float(dy @ dy)
    slope = float(dx @ dy) / sxx
    intercept = float(ys.mean()) - slope * float(xs.mean())
    residual = dy - slope * dx
    sse = float(residual @ residual)
    s = math.sqrt(sse / (n - 2))
    u_slope = s / math.sqrt(sxx)
    u_intercept = s * math.sqrt(1.0 / n + float(xs.mean()) ** 2 / sxx)

    def p(value: float, u: float) -> float:
        return 2.0 * float(stdtr(n - 2, -abs(value) / u)) if u > 0.0 else 0.0

    r2 = 1.0 - sse / syy if syy > 0.0 else math.nan
    return Line(
        intercept=intercept,
        slope=slope,
        u_intercept=u_intercept,
        u_slope=u_slope,
        p_intercept=p(intercept, u_intercept),
        p_slope=p(slope, u_slope),
        s=s,
        r2=r2,
        r2_adjusted=1.0 - (1.0 - r2) * (n - 1) / (n - 2),
        ss_regression=syy - sse,
        ss_error=sse,
        n=n,
    )


def mean_of_repeats(
    values: npt.ArrayLike, pooled_sd: float = math.nan, dof: int = 0
) -> tuple[float, float]:
    """Mean of replicates and its standard uncertainty, increased by Student's t for k = 2.

    Args:
        values: replicates of one setting; NaN are left out.
        pooled_sd: standard deviation pooled over all settings, used instead of that of ``values``.
        dof: degrees of freedom of ``pooled_sd``.
    """
    from scipy.special import stdtrit

    v = np.asarray(values, dtype=np.float64)
    v = v[np.isfinite(v)]
    if not len(v):
        return math.nan, math.nan
    sd, nu = (
        (pooled_sd, dof) if dof > 0 else (float(v.std(ddof=1)) if len(v) > 1 else 0.0, len(v) - 1)
    )
    if nu < 1:
        return float(v.mean()), math.nan
    return float(v.mean()), sd / math.sqrt(len(v)) * float(stdtrit(nu, 0.977249868)) / 2.0


def pooled(groups: list[Array]) -> tuple[float, int]:
    """Pooled standard deviation within groups, and its degrees of freedom."""
    ss, dof = 0.0, 0
    for group in groups:
        v = group[np.isfinite(group)]
        if len(v) > 1:
            ss += float(((v - v.mean()) ** 2).sum())
            dof += len(v) - 1
    return (math.sqrt(ss / dof), dof) if dof else (math.nan, 0)
