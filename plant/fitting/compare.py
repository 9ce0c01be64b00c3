"""Comparison of models by cross-validation, with tests of significance.

Whole groups are held out (lengths, temperatures or mountings), never single rows: rows of the same
length share its error, so a single row is not independent data. For the same reason, intervals and
tests resample groups, not rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import numpy.typing as npt

from plant.arrays import Array
from plant.errors import PlantError
from plant.fitting.data import Points
from plant.fitting.fit import fit
from plant.models.model import Model

LEAST_GROUP = 2.0
"""Minimum mean number of points per group; with fewer, groups are almost single rows."""
REGIONS = {"0-125 kPa": (0.0, 125.5e3), "150-600 kPa": (149.5e3, np.inf)}
RESAMPLES = 4000
EXACT_GROUPS = 14
"""Largest number of groups for which all sign changes are tried; above, a random sample."""
SIGNIFICANCE = 0.05


@dataclass(frozen=True)
class Score:
    """Result of one model on the held-out points, in N; residual = measured - modelled.

    Attributes:
        model: name; `parameters` is the number of fitted parameters.
        rmse_n, bias_n, worst_n: over all points; `worst_n` keeps its sign.
        rmse_low_n, rmse_high_n: 95 % interval of the rmse (bootstrap over groups).
        regions: rmse by pressure region, NaN where there are no points.
        train_rmse_n: rmse of the fit to all points, for comparison.
        excess_n: rmse above the best model's, with its 95 % interval (`excess_low_n`, ...).
        p: p-value of the difference to the best model (sign changes over groups, Holm).
        real: p below 5 %; False for the best model.
        residual_n: held-out residuals, shape (n,).
        trouble: error in a fold; such a model is ranked last.
    """

    model: str
    parameters: int
    rmse_n: float
    bias_n: float
    worst_n: float
    rmse_low_n: float
    rmse_high_n: float
    regions: dict[str, float]
    train_rmse_n: float
    excess_n: float
    excess_low_n: float
    excess_high_n: float
    p: float
    real: bool
    residual_n: Array
    trouble: str = ""


@dataclass(frozen=True)
class Floors:
    """Lower limits of the error of any model, in N.

    `repeat_n`: standard deviation of repeated cells (nan without repeats), with `repeats` degrees
    of freedom. `between_lengths_n`: rms error of interpolation of each length from its neighbours
    at the same pressure and temperature, the scatter that a smooth model cannot describe.
    """

    repeat_n: float
    repeats: int
    between_lengths_n: float


@dataclass(frozen=True)
class Comparison:
    """Models ranked by held-out rmse, best first.

    `nested_rmse_n` is the rmse when the best model is chosen in each fold from its training data
    only, so it includes the cost of the choice. nan if not requested.
    """

    scores: tuple[Score, ...]
    holdout: str
    groups: tuple[str, ...]
    points: int
    floors: Floors
    nested_rmse_n: float
    nested_choices: tuple[str, ...]
    source: str


def compare(
    models: Sequence[Model],
    points: Points,
    holdout: str = "length",
    nested: bool = False,
    train: Points | None = None,
) -> Comparison:
    """Leave-one-group-out cross-validation of each model.

    Args:
        models: their free parameters are fitted in every fold.
        points: at least three groups.
        holdout: "length", "temperature", "mounting" or "load".
        nested: also compute the cost of choosing the best model.
        train: fit once to these points instead, and score on all of `points` (for example from
            another day). The groups are then only used for resampling.

    Raises:
        PlantError: too few groups, an unknown holdout, or no models.
    """
    labels = points.labels(holdout)
    groups = _ordered(labels, points, holdout)
    if len(groups) < 3:
        raise PlantError(
            f"{points.source}: {len(groups)} {holdout} group(s); whole groups are held out, so at "
            "least three are needed: measure more, or use another holdout"
        )
    if len(points) / len(groups) < LEAST_GROUP:
        raise PlantError(
            f"{points.source}: {len(points)} points in {len(groups)} {holdout} groups: that would "
            "hold out single rows; hold out loads (isotonic tests) or mountings instead"
        )
    if not models:
        raise PlantError("no model to compare; name at least one")
    found = [_held_out(m, points, labels, groups, train) for m in models]
    order = sorted(range(len(models)), key=lambda k: _rms(found[k][0]))
    squares = np.array([_by_group(found[k][0], labels, groups) for k in order])
    sizes = np.array([np.sum(labels == g) for g in groups], dtype=np.float64)
    tests = _tests(squares)
    rng = np.random.default_rng(1996)
    drawn = rng.integers(0, len(groups), (RESAMPLES, len(groups)))
    means = np.sqrt(squares[:, drawn].sum(axis=2) / sizes[drawn].sum(axis=1))
    scores = []
    for rank, k in enumerate(order):
        residual, train_rmse, trouble = found[k]
        low, high = _interval(means[rank])
        excess = _interval(means[rank] - means[0])
        scores.append(
            Score(
                model=models[k].name,
                parameters=sum(not p.fixed for p in models[k].parameters),
                rmse_n=_rms(residual),
                bias_n=float(np.mean(residual)),
                worst_n=float(residual[np.argmax(np.abs(residual))]),
                rmse_low_n=low,
                rmse_high_n=high,
                regions=_regions(residual, points),
                train_rmse_n=train_rmse,
                excess_n=_rms(residual) - _rms(found[order[0]][0]),
                excess_low_n=excess[0],
                excess_high_n=excess[1],
                p=tests[rank],
                real=rank > 0 and tests[rank] < SIGNIFICANCE,
                residual_n=residual,
                trouble=trouble,
            )
        )
    nested_rmse, choices = (
        (np.nan, ()) if not nested or train else _nested(models, points, labels, groups)
    )
    return Comparison(
        tuple(scores), holdout, groups, len(points), floors(points), nested_rmse, choices,
        points.source if train is None else f"{points.source}, fitted to {train.source}",
    )  # fmt: skip


@dataclass(frozen=True)
class PressureScore:
    """Errors of one model at the pressures that it was not fitted to.

    Attributes:
        model: name; `parameters` is the number of fitted parameters.
        rmse_n, worst_n: over the held-out points; `worst_n` keeps its sign.
        rmse_percent, worst_percent: the same over the largest force of all points, in percent.
        rmse_mm, worst_mm: the same as a length: the error of the force over the stiffness dF/dL of
            the fitted model in the point.
        residual_n: held-out residuals, shape (m,).
        trouble: why there is no score; such a model is ranked last.
    """

    model: str
    parameters: int
    rmse_n: float
    worst_n: float
    rmse_percent: float
    worst_percent: float
    rmse_mm: float
    worst_mm: float
    residual_n: Array
    trouble: str = ""


@dataclass(frozen=True)
class PressureComparison:
    """Models ranked by their rmse at held-out pressures, best first."""

    scores: tuple[PressureScore, ...]
    fitted_kpa: tuple[str, ...]
    held_out_kpa: tuple[str, ...]
    points: int
    largest_force_n: float
    source: str


LEAST_PRESSURES = 4
"""Fewer pressures leave less than two to fit."""


def held_pressures(
    model: Model, points: Points, free: tuple[str, ...] | None = None
) -> tuple[Array, npt.NDArray[np.bool_], Model]:
    """Residuals of a fit to every other pressure, at the other pressures.

    The lowest pressure is fitted, the next is held out, and so on.

    Returns:
        residuals in N, shape (m,); mask of the held-out points, shape (n,); the fitted model.

    Raises:
        PlantError: fewer than four pressures, or no fit.
    """
    labels = points.labels("pressure")
    groups = _ordered(labels, points, "pressure")
    if len(groups) < LEAST_PRESSURES:
        raise PlantError(
            f"{points.source}: {len(groups)} pressure group(s); every other pressure is held out, "
            f"so at least {LEAST_PRESSURES} are needed: measure more, or use another holdout"
        )
    out = np.isin(labels, groups[1::2])
    fitted = fit(model, points.take(~out), free=free).model
    residual = _residual(fitted, points.take(out))
    if not np.all(np.isfinite(residual)):
        raise PlantError(
            f"model {model.name} has no value for some held-out points: outside the range of the "
            "fitted geometry"
        )
    return residual, out, fitted


def compare_pressures(models: Sequence[Model], points: Points) -> PressureComparison:
    """Fit each model to every other pressure and score it at the others.

    Raises:
        PlantError: fewer than four pressures, or no models.
    """
    groups = _ordered(points.labels("pressure"), points, "pressure")
    if len(groups) < LEAST_PRESSURES and models:
        held_pressures(models[0], points)  # raises, with the reason
    if not models:
        raise PlantError("no model to compare; name at least one")
    largest = float(np.max(np.abs(points.force_n)))
    scores = [_pressure_score(m, points, largest) for m in models]
    return PressureComparison(
        tuple(sorted(scores, key=lambda s: s.rmse_n)), groups[::2], groups[1::2], len(points),
        largest, points.source,
    )  # fmt: skip


def _pressure_score(model: Model, points: Points, largest: float) -> PressureScore:
    count = sum(not p.fixed for p in model.parameters)
    try:
        residual, out, fitted = held_pressures(model, points)
    except PlantError as error:
        return PressureScore(model.name, count, *(np.inf,) * 6, np.empty(0), str(error))
    at = points.take(out)
    _, stiffness, _ = fitted.law.slopes(
        fitted.q, at.pressure_pa, at.length_m, at.temperature_c, at.path
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        length_mm = residual / np.abs(stiffness) * 1e3
    worst, far = (float(x[np.argmax(np.abs(x))]) for x in (residual, length_mm))
    rms = _rms(residual)
    return PressureScore(
        model.name, count, rms, worst, 100 * rms / largest, 100 * worst / largest,
        _rms(length_mm), far, residual,
    )  # fmt: skip


def floors(points: Points) -> Floors:
    """Repeatability and scatter between lengths of the data."""
    repeat, count = np.nan, 0
    if points.cell is not None:
        square, dof = 0.0, 0
        for cell in np.unique(points.cell):
            force = points.force_n[points.cell == cell]
            square += float(np.sum((force - force.mean()) ** 2))
            dof += force.size - 1
        if dof:
            repeat, count = float(np.sqrt(square / dof)), dof
    misses = []
    for p, t in sorted(set(zip(points.pressure_pa.round(-3), points.temperature_c, strict=True))):
        here = (points.pressure_pa.round(-3) == p) & (points.temperature_c == t)
        lengths = np.unique(points.length_m[here].round(5))
        force = np.array(
            [np.mean(points.force_n[here & (points.length_m.round(5) == x)]) for x in lengths]
        )
        for k in range(1, lengths.size - 1):
            between = np.interp(lengths[k], lengths[[k - 1, k + 1]], force[[k - 1, k + 1]])
            misses.append(force[k] - between)
    scatter = float(np.sqrt(np.mean(np.square(misses)))) if misses else np.nan
    return Floors(repeat, count, scatter)


def _held_out(
    model: Model,
    points: Points,
    labels: npt.NDArray[np.str_],
    groups: tuple[str, ...],
    train: Points | None,
) -> tuple[Array, float, str]:
    """Held-out residuals, rmse of the fit to all points, and an error text or ""."""
    residual = np.full(len(points), np.inf)
    trouble = ""
    try:
        whole = fit(model, points if train is None else train)
        if train is not None:
            residual = _residual(whole.model, points)
        for group in groups if train is None else ():
            out = labels == group
            fitted = fit(model, points.take(~out)).model
            residual[out] = _residual(fitted, points.take(out))
    except PlantError as error:
        return np.full(len(points), np.inf), np.nan, str(error)
    if not np.all(np.isfinite(residual)):
        trouble = "no value for some held-out points: outside the range of the fitted geometry"
        residual = np.where(np.isfinite(residual), residual, np.inf)
    return residual, whole.rmse_n, trouble


def _residual(model: Model, points: Points) -> Array:
    with np.errstate(invalid="ignore", divide="ignore"):
        modelled = model.law.force(
            model.q, points.pressure_pa, points.length_m, points.temperature_c, points.path
        )
    return np.asarray(points.force_n - modelled)


def _nested(
    models: Sequence[Model], points: Points, labels: npt.NDArray[np.str_], groups: tuple[str, ...]
) -> tuple[float, tuple[str, ...]]:
    """Rmse and choices when each fold chooses its model by the other groups only."""
    squares = np.zeros((len(models), len(groups), len(groups)))
    for m, model in enumerate(models):
        for a, b in product(range(len(groups)), repeat=2):
            if a > b:
                continue
            out = (labels == groups[a]) | (labels == groups[b])
            try:
                fitted = fit(model, points.take(~out)).model
            except PlantError:
                squares[m, a, b] = squares[m, b, a] = np.inf
                continue
            for held, other in ((a, b), (b, a)):
                rest = points.take(labels == groups[other])
                squares[m, held, other] = float(np.sum(_residual(fitted, rest) ** 2))
    total, choices = 0.0, []
    for k in range(len(groups)):
        inner = [np.sum(np.delete(squares[m, k], k)) for m in range(len(models))]
        best = int(np.argmin(inner))
        choices.append(models[best].name)
        total += squares[best, k, k]
    return float(np.sqrt(total / len(points))), tuple(choices)


def _tests(squares: Array) -> list[float]:
    """Holm-corrected p-value of each model against the first (sign-flip test over groups)."""
    count = squares.shape[1]
    if count <= EXACT_GROUPS:
        signs = np.array(list(product((1.0, -1.0), repeat=count)))
    else:
        signs = np.random.default_rng(1996).choice((1.0, -1.0), (20000, count))
        signs[0] = 1.0
    raw = [1.0]
    for row in squares[1:]:
        difference = row - squares[0]
        if not np.all(np.isfinite(difference)):
            raw.append(0.0)
            continue
        totals = np.abs(signs @ difference)
        raw.append(float(np.mean(totals >= totals[0] * (1 - 1e-12))))
    corrected, running = [1.0] * len(raw), 0.0
    order = sorted(range(1, len(raw)), key=lambda k: raw[k])
    for place, k in enumerate(order):
        running = max(running, min(1.0, raw[k] * (len(order) - place)))
        corrected[k] = running
    return corrected


def _by_group(residual: Array, labels: npt.NDArray[np.str_], groups: tuple[str, ...]) -> Array:
    return np.array([float(np.sum(residual[labels == g] ** 2)) for g in groups])


def _regions(residual: Array, points: Points) -> dict[str, float]:
    found = {}
    for name, (low, high) in REGIONS.items():
        use = (points.pressure_pa >= low) & (points.pressure_pa <= high)
        found[name] = _rms(residual[use]) if np.any(use) else np.nan
    return found


def _ordered(labels: npt.NDArray[np.str_], points: Points, holdout: str) -> tuple[str, ...]:
    known = {
        "length": points.length_m,
        "temperature": points.temperature_c,
        "pressure": points.pressure_pa,
    }
    by = (known | {"load": points.force_n}).get(holdout)
    names = np.unique(labels)
    if by is None:
        return tuple(str(n) for n in names)
    return tuple(str(n) for n in sorted(names, key=lambda n: float(np.mean(by[labels == n]))))


def _interval(values: Array) -> tuple[float, float]:
    if not np.all(np.isfinite(values)):
        return np.inf, np.inf
    low, high = np.percentile(values, [2.5, 97.5])
    return float(low), float(high)


def _rms(x: Array) -> float:
    return float(np.sqrt(np.mean(np.square(x))))
