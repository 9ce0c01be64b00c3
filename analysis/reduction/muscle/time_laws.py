"""Laws of a quantity over the time for which something is held: logarithm or exponentials.

Autocorrelation: readings near each other in time err alike, by a wandering pressure or
temperature. The residuals of a fit show that. Their integrated autocorrelation time tau
(:func:`analysis.reduction.uncertainty.correlation_time`) says how many points are worth one
independent one. The standard uncertainties of a fit are those of least squares with the scatter of
the residuals, times sqrt(tau), times Student's t for n / tau - k degrees of freedom, so that k = 2
covers 95 %. The choice between laws counts n / tau points as well.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from analysis.reduction.uncertainty import correlation_time, student_ratio
from plant.arrays import Array

PLAIN, LOGARITHMIC, ONE, TWO = "constant", "logarithmic", "one exponential", "two exponentials"
LAWS = (PLAIN, LOGARITHMIC, ONE, TWO)
GRID = 24
"""Time constants tried before the best are refined."""
CLOSE = 2.0
"""Laws whose AICc differs by less are about as good (Burnham and Anderson 2002, section 2.6)."""
FEWEST = 6
"""A law is fitted to this many points or more."""


@dataclass(frozen=True)
class TimeLaw:
    """A fitted law y(t).

    Attributes:
        name: one of ``LAWS``.
        values: of the law: level; slope per decade, or amplitude and time constant (s) of each
            exponential.
        u: their standard uncertainties, with the autocorrelation of the residuals.
        by_cause: slope of y against the second quantity (the pressure), NaN if it was not fitted.
        aicc: Akaike's criterion with the correction for few points.
        s: standard deviation of the weighted residuals, in units of y.
        tau: integrated autocorrelation time of the residuals, in points.
        time_s, residuals: of the points, shapes (n,).
    """

    name: str
    values: tuple[float, ...]
    u: tuple[float, ...]
    by_cause: float
    aicc: float
    s: float
    tau: float
    time_s: Array
    residuals: Array

    def at(self, time_s: Array) -> Array:
        """Values of the law."""
        return _law(self.name, np.asarray(time_s, dtype=np.float64), self.values)

    @property
    def rate(self) -> tuple[float, float]:
        """Slope per decade and its uncertainty; NaN for other laws than the logarithmic."""
        return (self.values[1], self.u[1]) if self.name == LOGARITHMIC else (math.nan, math.nan)


def fit_time_laws(
    time_s: Array,
    y: Array,
    u: Array,
    cause: Array | None = None,
    expected: tuple[float, float] = (0.0, 1.0),
) -> list[TimeLaw]:
    """Fit each law of ``LAWS``; those with too few points for them are left out.

    Args:
        time_s: increasing and positive, shape (n,).
        y: values; ``u``: their uncertainties by noise, which weight them; shapes (n,).
        cause: what else moves y, as its deviation from its set-point (the pressure), shape (n,);
            None for nothing.
        expected: slope of y against ``cause``, with its standard uncertainty. The fitted one is
            drawn to it, so that a cause that hardly moves does no harm.

    Returns:
        Laws in the order of ``LAWS``; empty with fewer than ``FEWEST`` points.
    """
    good = np.isfinite(time_s) & np.isfinite(y) & (time_s > 0.0)
    t, values = time_s[good], y[good]
    if len(t) < FEWEST:
        return []
    moved = cause[good] if cause is not None and np.isfinite(cause[good]).all() else None
    problem = _Problem(t, values, _weights(u[good]), moved, expected)
    made = [problem.fit(name) for name in LAWS]
    found = [law for law in made if law is not None]
    tau = min((law.tau for law in found), default=1.0)
    return [problem.judged(law, tau) for law in found]


def fit_rate(
    time_s: Array, y: Array, u: Array, cause: Array | None, expected: tuple[float, float]
) -> TimeLaw | None:
    """The logarithmic law alone, for its slope per decade; arguments as for `fit_time_laws`.

    Where a line over log t does not fit, what it leaves is part of every weight: parts of the
    time that were averaged longer then count no more than others. None with too few points.
    """
    good = np.isfinite(time_s) & np.isfinite(y) & (time_s > 0.0)
    t, values, noise = time_s[good], y[good], u[good]
    if len(t) < FEWEST:
        return None
    left = values - np.polyval(np.polyfit(np.log10(t), values, 1), np.log10(t))
    excess = max(float(np.mean(left**2) - np.nanmean(noise**2)), 0.0)
    moved = cause[good] if cause is not None and np.isfinite(cause[good]).all() else None
    weight = _weights(np.sqrt(noise**2 + excess))
    return _Problem(t, values, weight, moved, expected).fit(LOGARITHMIC)


def _weights(u: Array) -> Array:
    """Weights by noise, with a mean of 1; equal ones where no noise is known."""
    noise = np.where(np.isfinite(u) & (u > 0.0), u, np.nan)
    if np.isnan(noise).all():
        return np.ones(len(u))
    weight = 1.0 / np.where(np.isnan(noise), np.nanmedian(noise), noise)
    return np.asarray(weight / weight.mean())


def best_law(laws: list[TimeLaw]) -> TimeLaw:
    """The simplest law whose AICc is within ``CLOSE`` of the least."""
    least = min(law.aicc for law in laws)
    return next(law for law in laws if law.aicc <= least + CLOSE or law is laws[-1])


def _law(name: str, t: Array, values: tuple[float, ...]) -> Array:
    out = np.full(len(t), values[0])
    if name == LOGARITHMIC:
        out = out + values[1] * np.log10(t)
    for amplitude, tau_s in zip(values[1::2], values[2::2], strict=False):
        out = out + amplitude * np.exp(-t / tau_s)
    return np.asarray(out)


@dataclass(frozen=True)
class _Problem:
    t: Array
    y: Array
    weight: Array
    cause: Array | None
    expected: tuple[float, float]

    def columns(self, name: str, taus: tuple[float, ...]) -> Array:
        """Columns of the linear part: level, slope or amplitudes, cause."""
        parts = [np.ones(len(self.t))]
        if name == LOGARITHMIC:
            parts.append(np.log10(self.t))
        parts += [np.exp(-self.t / tau) for tau in taus]
        if self.cause is not None:
            parts.append(self.cause)
        return np.column_stack(parts)

    def linear(self, name: str, taus: tuple[float, ...], s: float) -> tuple[Array, float]:
        """Linear parameters and the weighted sum of squares.

        ``s``: scale of the residuals, by which the expected effect of the cause is weighted.
        """
        columns = self.columns(name, taus) * self.weight[:, None]
        right = self.y * self.weight
        if self.cause is not None:
            slope, spread = self.expected
            prior = np.zeros((1, columns.shape[1]))
            prior[0, -1] = s / spread
            columns = np.vstack([columns, prior])
            right = np.append(right, slope * s / spread)
        found = np.linalg.lstsq(columns, right, rcond=None)[0]
        return np.asarray(found), float(np.sum((columns @ found - right) ** 2))

    def fit(self, name: str) -> TimeLaw | None:
        """One law, by a grid of time constants and a search from the best."""
        from scipy.optimize import minimize

        exponentials = LAWS.index(name) - 1 if name in (ONE, TWO) else 0
        free = 1 + (name == LOGARITHMIC) + 2 * exponentials + (self.cause is not None)
        if len(self.t) < free + 3:
            return None
        s = self._scale()
        taus: tuple[float, ...] = ()
        if exponentials:
            low, high = float(self.t[0]), 3.0 * float(self.t[-1])
            grid = np.geomspace(low, high, GRID)
            tried = (
                [(float(a),) for a in grid]
                if exponentials == 1
                else [(float(a), float(b)) for k, a in enumerate(grid) for b in grid[k + 3 :]]
            )
            start = min(tried, key=lambda one: self.linear(name, one, s)[1])
            bound = math.log(low / 3.0), math.log(10.0 * high)

            def cost(logs: Array) -> float:
                inside = np.clip(logs, *bound)
                excess = float(np.sum((logs - inside) ** 2))
                return self.linear(name, tuple(np.exp(inside)), s)[1] * (1.0 + excess)

            found = minimize(cost, np.log(start), method="Nelder-Mead", options={"xatol": 1e-5})
            taus = tuple(sorted(float(x) for x in np.exp(np.clip(found.x, *bound))))
        return self._finish(name, taus, free, s)

    def _scale(self) -> float:
        """Rough scale of the weighted residuals, by second differences."""
        second = np.abs(np.diff(self.y, 2)) * self.weight[1:-1]
        return max(1.4826 * float(np.median(second)) / math.sqrt(6.0), 1e-12)

    def _finish(self, name: str, taus: tuple[float, ...], free: int, s: float) -> TimeLaw:
        linear, _ = self.linear(name, taus, s)
        n = len(self.t)
        level = 2 if name == LOGARITHMIC else 1
        values = [float(v) for v in linear[:level]]
        for k, tau_s in enumerate(taus):
            values += [float(linear[1 + k]), tau_s]
        fitted = self.columns(name, taus) @ linear
        residuals = self.y - fitted
        weighted = residuals * self.weight
        tau = correlation_time(weighted) if n >= 8 else 1.0
        tau = min(tau, max((n - free) / 3.0, 1.0))
        scatter = math.sqrt(float(weighted @ weighted) / (n - free))
        jacobian = self._jacobian(name, values, linear)
        u = np.sqrt(np.diag(np.linalg.pinv(jacobian.T @ jacobian))) * scatter
        u = u * math.sqrt(tau) * student_ratio(max(n / tau - free, 1.0))
        cause = float(linear[-1]) if self.cause is not None else math.nan
        return TimeLaw(
            name, tuple(values), tuple(float(x) for x in u[: len(values)]), cause, math.nan,
            scatter, tau, self.t, residuals,
        )  # fmt: skip

    def _jacobian(self, name: str, values: list[float], linear: Array) -> Array:
        """Weighted derivatives of the fitted values by each parameter, the cause's last."""
        parts = []
        for k, value in enumerate(values):
            step = 1e-6 * max(abs(value), 1e-3)
            ends = []
            for way in (step, -step):
                moved = [*values[:k], value + way, *values[k + 1 :]]
                ends.append(_law(name, self.t, tuple(moved)))
            parts.append((ends[0] - ends[1]) / (2.0 * step))
        out = np.column_stack(parts) * self.weight[:, None]
        if self.cause is not None:
            column = np.append(self.cause * self.weight, self._scale() / self.expected[1])
            out = np.column_stack([np.vstack([out, np.zeros(out.shape[1])]), column])
        return np.asarray(out)

    def judged(self, law: TimeLaw, tau: float) -> TimeLaw:
        """The law with its AICc, for n / tau independent points."""
        n = len(self.t) / tau
        free = len(law.values) + (self.cause is not None) + 1  # and the scatter
        mean_square = float(np.mean((law.residuals * self.weight) ** 2))
        if n - free - 1.0 <= 0.0 or mean_square <= 0.0:
            return replace(law, aicc=math.inf)
        penalty = 2.0 * free + 2.0 * free * (free + 1.0) / (n - free - 1.0)
        return replace(law, aicc=n * math.log(mean_square) + penalty)
