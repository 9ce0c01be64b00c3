"""Fit a model to settled points: values, intervals, and identifiability.

The fit propagates sensor errors: noise of pressure and length through the slopes of the model, and
zero and gain errors of each sensor as common errors of all points of a run, which correlate the
residuals. With the resulting covariance V of the residuals r, the fit minimises r' V^-1 r
(generalised least squares). Without stated errors it is ordinary least squares.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np

from plant.arrays import Array
from plant.errors import PlantError
from plant.fitting.data import Points
from plant.fitting.identify import Identifiability, examine
from plant.models.model import Domain, Model
from plant.models.uncertainty import Covariance

MAX_ROUNDS = 8
HUBER = 1.345
"""Number of robust standard deviations beyond which a robust fit reduces the weight."""
CONFIDENCE = 0.95
"""Level of the intervals of a fit."""


@dataclass(frozen=True)
class Estimate:
    """One fitted parameter, in its own unit.

    `low` and `high` are the limits of the interval: infinite for a parameter that the data do not
    determine, and equal to `value` for a fixed one. `state` is "free", "fixed", "dead",
    "flat" or "at bound".
    """

    name: str
    unit: str
    value: float
    sd: float
    low: float
    high: float
    state: str


@dataclass(frozen=True)
class Fit:
    """Result of a fit.

    Attributes:
        model: the model with fitted values, domain and hash of the data.
        estimates: all parameters, in order.
        covariance: of the free parameters in their own units, shape (k, k).
        free: names of the free parameters.
        residual_n: measured - modelled force, shape (n,).
        rmse_n: root mean square of the residuals.
        sd_n: standard deviation of the residuals, with n - k degrees of freedom.
        noise_scale: ratio of the scatter to the stated noise; nan if no noise is stated.
        robust: whether the weight of outliers was reduced.
        identifiability: dead parameters, flat directions, parameters at a bound.
    """

    model: Model
    estimates: tuple[Estimate, ...]
    covariance: Array
    free: tuple[str, ...]
    residual_n: Array
    rmse_n: float
    sd_n: float
    noise_scale: float
    robust: bool
    identifiability: Identifiability

    def estimate(self, name: str) -> Estimate:
        """A parameter by name. Raises `PlantError` if unknown."""
        self.model.parameter(name)
        return next(e for e in self.estimates if e.name == name)


def fit(
    model: Model,
    points: Points,
    *,
    free: tuple[str, ...] | None = None,
    robust: bool = False,
) -> Fit:
    """Fit the free parameters of a model to settled points.

    Args:
        model: its values are the start values; its bounds apply.
        points: more points than free parameters.
        free: names of the parameters to fit; default: all that are not fixed.
        robust: use Huber weights.

    Raises:
        PlantError: too few points, an unknown parameter, or no value at the start values.
    """
    names = _free_names(model, free)
    if len(points) <= len(names):
        raise PlantError(
            f"model {model.name} has {len(names)} free parameters and {points.source or 'the data'}"
            f" {len(points)} points; give more points, or fix parameters"
        )
    if model.law.memory and points.path is None:
        raise PlantError(
            f"model {model.name} has memory, and {points.source} has no order of points; "
            "use a run or Table C-4"
        )
    problem = _Problem(model, points, [model.law.parameters.index(n) for n in names])
    theta = problem.start()
    scale = 1.0
    weights = np.ones(len(points))
    for _ in range(5 * MAX_ROUNDS if robust else MAX_ROUNDS):
        whiten = problem.whitener(theta, scale, weights)
        new = problem.minimise(theta, whiten)
        residual = problem.residual(new)
        new_scale = problem.noise_scale(new, residual)
        moved = np.max(np.abs(new - theta) / problem.size) + abs(new_scale / scale - 1.0)
        if robust:
            plain = problem.whitener(new, new_scale, np.ones(len(points)))
            before, weights = weights, _huber(plain(residual))
            moved += np.max(np.abs(weights - before))
        theta, scale = new, new_scale
        if moved < 1e-7 or (problem.plain and not robust):
            break
    return _result(problem, theta, scale, weights, names, robust)


class _Problem:
    """Residuals of one model on one set of points, as functions of the free parameters in SI."""

    def __init__(self, model: Model, points: Points, free: list[int]) -> None:
        self.model, self.points, self.free = model, points, free
        factors = np.array([p.to_si for p in model.parameters])
        self.q = model.q
        chosen = [model.parameters[k] for k in free]
        self.low = np.array([p.low for p in chosen]) * factors[free]
        self.high = np.array([p.high for p in chosen]) * factors[free]
        self.factors = factors[free]
        self.size = np.where(self.q[free] != 0, np.abs(self.q[free]), self.factors)
        arrays = (points.sd_pressure_pa, points.sd_length_m, points.sd_force_n)
        self.noisy = all(a is not None and bool(np.all(np.isfinite(a))) for a in arrays)
        self.plain = not self.noisy and not points.sensors

    def start(self) -> Array:
        return np.asarray(np.clip(self.q[self.free], self.low, self.high), dtype=np.float64)

    def full(self, theta: Array) -> Array:
        q = self.q.copy()
        q[self.free] = theta
        return q

    def residual(self, theta: Array) -> Array:
        x = self.points
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            modelled = self.model.law.force(
                self.full(theta), x.pressure_pa, x.length_m, x.temperature_c, x.path
            )
        return np.asarray(x.force_n - modelled, dtype=np.float64)

    def jacobian(self, theta: Array) -> Array:
        """dF/dtheta, shape (n, k)."""
        x = self.points
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            rows = self.model.law.jacobian(
                self.full(theta), x.pressure_pa, x.length_m, x.temperature_c, x.path
            )
        return np.asarray(rows[self.free].T, dtype=np.float64)

    def shares(self, theta: Array) -> tuple[Array, Array]:
        """Noise variance of the residuals, shape (n,); effects of common sensor errors, (n, m)."""
        x = self.points
        n = len(x)
        by_p, by_l, _ = self.model.law.slopes(
            self.full(theta), x.pressure_pa, x.length_m, x.temperature_c, x.path
        )
        noise = np.zeros(n)
        if self.noisy:
            pairs = ((x.sd_pressure_pa, by_p), (x.sd_length_m, by_l), (x.sd_force_n, 1.0))
            for sd, slope in pairs:
                noise = noise + np.square(np.asarray(sd) * slope)
        columns = []
        readings = {"pressure": x.pressure_pa, "length": x.length_m, "force": x.force_n}
        slopes = {"pressure": by_p, "length": by_l, "force": np.ones(n)}
        for name, sensor in x.sensors.items():
            zero = slopes[name] * sensor.zero
            if sensor.zero_per_trial:
                trial = x.trials()
                columns += [zero * (trial == k) for k in np.unique(trial)]
            else:
                columns.append(zero)
            columns.append(slopes[name] * sensor.gain * (readings[name] - sensor.origin))
        return noise, np.column_stack(columns) if columns else np.zeros((n, 0))

    def covariance(self, theta: Array, scale: float) -> Array:
        noise, common = self.shares(theta)
        floor = 1e-12 if self.noisy else 1.0
        variance = noise * scale**2 if self.noisy else np.full(len(self.points), scale**2)
        return np.diag(np.maximum(variance, floor * 1e-12)) + common @ common.T

    def whitener(self, theta: Array, scale: float, weights: Array) -> Any:
        """A function that whitens residuals (independent, unit variance)."""
        root = np.sqrt(weights)
        if self.plain:
            return lambda a: (a.T * root).T
        from scipy.linalg import solve_triangular

        lower = np.linalg.cholesky(self.covariance(theta, scale))
        return lambda a: (solve_triangular(lower, a, lower=True).T * root).T

    def noise_scale(self, theta: Array, residual: Array) -> float:
        """Factor on the noise for which r' V^-1 r equals its degrees of freedom.

        At least 1 if noise is stated: a run is never better than its sensors.
        """
        dof = max(len(residual) - len(theta), 1)
        if self.plain:
            return 1.0
        from scipy.optimize import brentq

        noise, common = self.shares(theta)

        def excess(log_scale: float) -> float:
            variance = noise * np.exp(2 * log_scale) if self.noisy else np.exp(2 * log_scale)
            inverse = 1.0 / np.maximum(variance, 1e-24)
            inner = np.eye(common.shape[1]) + (common.T * inverse) @ common
            scaled = residual * inverse
            correction = common.T @ scaled
            chi2 = residual @ scaled - correction @ np.linalg.solve(inner, correction)
            return float(np.log(max(chi2, 1e-300) / dof))

        low = 0.0 if self.noisy else -20.0
        if excess(low) <= 0:
            return float(np.exp(low))
        return float(np.exp(brentq(excess, low, 25.0, xtol=1e-9)))

    def minimise(self, theta: Array, whiten: Any) -> Array:
        if self.model.law.linear:
            found = self._linear(theta, whiten)
            if np.all((found >= self.low) & (found <= self.high)):
                return found
        from scipy.optimize import least_squares

        start = np.clip(theta, self.low, self.high)
        if not np.all(np.isfinite(self.residual(start))):
            raise PlantError(
                f"model {self.model.name} has no value for some points with its starting values "
                f"({', '.join(f'{k} = {v:g}' for k, v in self.model.values.items())}); "
                "use start values whose geometry includes all lengths"
            )
        bounds = (self.low / self.size, self.high / self.size)
        solution = least_squares(
            lambda s: _finite(whiten(self.residual(s * self.size))),
            np.clip(start / self.size, *bounds),
            jac=lambda s: -whiten(self.jacobian(s * self.size) * self.size),
            bounds=bounds,
            x_scale="jac",
            xtol=1e-13,
            ftol=1e-13,
            gtol=1e-13,
            max_nfev=2000,
        )
        return np.asarray(solution.x * self.size, dtype=np.float64)

    def _linear(self, theta: Array, whiten: Any) -> Array:
        import statsmodels.api as sm

        design = self.jacobian(theta)
        target = self.residual(theta) + design @ theta
        columns = np.sqrt(np.mean(design**2, axis=0))
        columns = np.where(columns > 0, columns, 1.0)
        with warnings.catch_warnings():
            # Flat directions are found and reported after the fit.
            warnings.simplefilter("ignore")
            solved = sm.OLS(whiten(target), whiten(design / columns)).fit()
        found = np.asarray(solved.params, dtype=np.float64) / columns
        # Keep the value of a parameter without effect.
        dead = np.all(design == 0, axis=0)
        return np.where(dead, theta, found)


def _result(
    problem: _Problem,
    theta: Array,
    scale: float,
    weights: Array,
    names: tuple[str, ...],
    robust: bool,
) -> Fit:
    from scipy.stats import norm
    from scipy.stats import t as student

    model, points = problem.model, problem.points
    residual = problem.residual(theta)
    dof = len(points) - len(theta)
    sd_n = float(np.sqrt(residual @ residual / dof))
    whiten = problem.whitener(theta, scale, weights)
    design = whiten(problem.jacobian(theta))
    found = examine(
        design * problem.factors, theta / problem.factors, names,
        problem.low / problem.factors, problem.high / problem.factors,
    )  # fmt: skip
    spread = _robust_variance(whiten(residual), weights, dof) if problem.plain else 1.0
    covariance = found.covariance * spread
    quantile = float(student.ppf((1 + CONFIDENCE) / 2, dof))
    if problem.noisy:
        quantile = float(norm.ppf((1 + CONFIDENCE) / 2))
    fitted = model.with_q(problem.full(theta))
    estimates = []
    for parameter in fitted.parameters:
        if parameter.name not in names:
            v = parameter.value
            estimates.append(Estimate(parameter.name, parameter.unit, v, 0.0, v, v, "fixed"))
            continue
        at = names.index(parameter.name)
        state = found.states[at]
        sd = float(np.sqrt(covariance[at, at])) if state in ("free", "at bound") else np.inf
        half = quantile * sd
        estimates.append(
            Estimate(parameter.name, parameter.unit, parameter.value, sd,
                     parameter.value - half, parameter.value + half, state)
        )  # fmt: skip
    noise_scale = scale if problem.noisy else float("nan")
    return Fit(
        model=_labelled(fitted, points, estimates, covariance),
        estimates=tuple(estimates),
        covariance=covariance,
        free=names,
        residual_n=residual,
        rmse_n=float(np.sqrt(np.mean(residual**2))),
        sd_n=sd_n,
        noise_scale=noise_scale,
        robust=robust,
        identifiability=found,
    )


def _labelled(model: Model, points: Points, estimates: list[Estimate], covariance: Array) -> Model:
    """The model with domain, source and hash of the data, standard deviations and covariance.

    `covariance` is that of the fitted parameters; parameters that the data do not determine are
    left out of the model's covariance, so it is positive.
    """
    from dataclasses import replace

    def span(values: Array, factor: float) -> tuple[float, float]:
        # Rounded, because the last bits of a reading are not significant.
        low, high = float(values.min()) / factor, float(values.max()) / factor
        return round(low, 6), round(high, 6)

    domain = Domain(
        span(points.pressure_pa, 1e3), span(points.length_m, 1e-3), span(points.temperature_c, 1.0)
    )
    sds = {e.name: e.sd for e in estimates}
    parameters = tuple(
        replace(p, sd=None if p.fixed or not np.isfinite(sds[p.name]) else sds[p.name])
        for p in model.parameters
    )
    fitted = [e for e in estimates if e.state != "fixed"]
    known = [k for k, e in enumerate(fitted) if np.isfinite(e.sd) and e.sd > 0]
    part = covariance[np.ix_(known, known)]
    part = (part + part.T) / 2.0  # symmetric to the last bit
    matrix = tuple(tuple(float(x) for x in row) for row in part)
    stated = Covariance(tuple(fitted[k].name for k in known), matrix) if known else None
    return replace(
        model, domain=domain, data=points.source, data_sha256=points.sha256(),
        parameters=parameters, covariance=stated,
    )  # fmt: skip


def _free_names(model: Model, free: tuple[str, ...] | None) -> tuple[str, ...]:
    if free is None:
        return tuple(p.name for p in model.parameters if not p.fixed)
    for name in free:
        model.parameter(name)
    return tuple(p.name for p in model.parameters if p.name in free)


def _finite(values: Array) -> Array:
    """Replace undefined residuals (impossible geometry) by a large value for the search."""
    return np.where(np.isfinite(values), values, 1e6)


def _huber(whitened: Array) -> Array:
    """Weights: 1 within HUBER robust standard deviations, decreasing beyond."""
    spread = float(np.median(np.abs(whitened))) / 0.6745 or 1.0
    z = np.abs(whitened) / spread
    return np.asarray(np.where(z <= HUBER, 1.0, HUBER / np.maximum(z, HUBER)))


def _robust_variance(whitened: Array, weights: Array, dof: int) -> float:
    """Variance of weighted residuals, with Huber's correction if weights differ from 1."""
    inside = float(np.mean(weights >= 1.0))
    return (
        float(whitened @ (whitened * weights) / dof / max(inside, 1e-9) ** 2)
        if np.any(weights < 1.0)
        else float(whitened @ whitened / dof)
    )
