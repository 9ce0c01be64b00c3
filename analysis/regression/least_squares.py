"""Straight lines by least squares with the table that a statistics package prints beside them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Line:
    """``y = intercept + slope x``, ordinary least squares.

    Attributes:
        intercept, slope: coefficients.
        u_intercept, u_slope: standard errors from the scatter, n - 2 degrees of freedom.
        p_intercept, p_slope: two-sided, of no effect.
        s: scatter about the line.
        r2, r2_adjusted: shares, 0 to 1.
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

    def at(self, x: npt.ArrayLike) -> Floats:
        """Values of the line."""
        return np.asarray(self.intercept + self.slope * np.asarray(x, dtype=np.float64))

    @property
    def t_slope(self) -> float:
        """Slope in its standard errors."""
        return self.slope / self.u_slope if self.u_slope else math.inf

    @property
    def t_intercept(self) -> float:
        """Intercept in its standard errors."""
        return self.intercept / self.u_intercept if self.u_intercept else math.inf

    @property
    def f(self) -> float:
        """F of the regression."""
        return self.ss_regression / (self.ss_error / (self.n - 2)) if self.ss_error else math.inf


def straight_line(x: npt.ArrayLike, y: npt.ArrayLike) -> Line | None:
    """Fit a line, shapes (n,); pairs with a NaN are left out.

    Returns:
        None for fewer than three points, or all at one x.
    """
    every_x, every_y = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
    good = np.isfinite(every_x) & np.isfinite(every_y)
    return _fit(every_x[good], every_y[good])


def _fit(x: Floats, y: Floats) -> Line | None:
    from scipy.special import stdtr

    n = len(x)
    if n < 3 or float(np.ptp(x)) == 0.0:
        return None
    dx, dy = x - x.mean(), y - y.mean()
    sxx, syy = float(dx @ dx), float(dy @ dy)
    slope = float(dx @ dy) / sxx
    intercept = float(y.mean()) - slope * float(x.mean())
    residual = dy - slope * dx
    sse = float(residual @ residual)
    s = math.sqrt(sse / (n - 2))
    u_slope = s / math.sqrt(sxx)
    u_intercept = s * math.sqrt(1.0 / n + float(x.mean()) ** 2 / sxx)

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
    """Mean of replicates and its standard uncertainty, widened by Student's t for k = 2.

    Args:
        values: replicates of one setting; NaN are left out.
        pooled_sd: scatter pooled over all settings, used instead of that of these few.
        dof: its degrees of freedom.
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


def pooled(groups: list[Floats]) -> tuple[float, int]:
    """Standard deviation within groups, pooled, and its degrees of freedom."""
    ss, dof = 0.0, 0
    for group in groups:
        v = group[np.isfinite(group)]
        if len(v) > 1:
            ss += float(((v - v.mean()) ** 2).sum())
            dof += len(v) - 1
    return (math.sqrt(ss / dof), dof) if dof else (math.nan, 0)
