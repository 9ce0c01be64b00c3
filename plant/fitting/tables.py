"""Regression tables in the format of the thesis: best subsets and full regressions.

The least squares are from statsmodels; this module selects predictors and formats numbers.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from plant.arrays import Array
from plant.errors import PlantError
from plant.fitting.data import Points
from plant.models.model import Model
from plant.models.terms import Term, TermLaw


@dataclass(frozen=True)
class Predictor:
    """One line of a full regression."""

    name: str
    coef: float
    stdev: float
    t: float
    p: float


@dataclass(frozen=True)
class Source:
    """One line of an analysis of variance; `f` and `p` only for the regression."""

    source: str
    df: int
    ss: float
    ms: float
    f: float
    p: float


@dataclass(frozen=True)
class FullRegression:
    """A full regression: predictors (constant first), s, R-sq and its adjusted form in percent,
    and the analysis of variance (regression, error, total).
    """

    response: str
    predictors: tuple[Predictor, ...]
    s: float
    r2_percent: float
    r2adj_percent: float
    anova: tuple[Source, Source, Source]

    def text(self) -> str:
        """The table in the format of Appendix C-2 of the thesis."""
        lines = [f"The regression equation is: {self.response} = {self._equation()}", ""]
        lines.append(f"{'Predictor':<14}{'Coef':>14}{'Stdev':>14}{'t-ratio':>10}{'p':>8}")
        for x in self.predictors:
            lines.append(f"{x.name:<14}{x.coef:>14.6g}{x.stdev:>14.4g}{x.t:>10.2f}{x.p:>8.3f}")
        percent = f"R-sq = {self.r2_percent:.1f}%    R-sq(adj) = {self.r2adj_percent:.1f}%"
        lines += ["", f"s = {self.s:.4g}    {percent}", "", "Analysis of Variance", ""]
        lines.append(f"{'SOURCE':<12}{'DF':>5}{'SS':>14}{'MS':>14}{'F':>11}{'p':>8}")
        for row in self.anova:
            tail = f"{row.f:>11.2f}{row.p:>8.3f}" if row.source == "Regression" else ""
            ms = "" if row.source == "Total" else f"{row.ms:>14.5g}"
            lines.append(f"{row.source:<12}{row.df:>5}{row.ss:>14.5g}{ms}{tail}")
        return "\n".join(lines)

    def _equation(self) -> str:
        first, *rest = self.predictors
        return f"{first.coef:.3g} " + " ".join(f"{x.coef:+.3g} {x.name}" for x in rest)


@dataclass(frozen=True)
class Subset:
    """One line of a best-subsets table."""

    vars: int
    r2_percent: float
    r2adj_percent: float
    cp: float
    s: float
    names: tuple[str, ...]


def full_regression(response: str, y: Array, predictors: Mapping[str, Array]) -> FullRegression:
    """Regress y, shape (n,), on a constant and the named predictors.

    Raises `PlantError` if there are too few points or the predictors are not independent.
    """
    import statsmodels.api as sm

    names = list(predictors)
    n, k = len(y), len(names)
    if n <= k + 1:
        raise PlantError(f"{response}: {n} points cannot determine {k + 1} coefficients")
    raw = np.column_stack([np.ones(n), *predictors.values()])
    # Scale the columns, because P L^3 and 1 differ by orders of magnitude.
    size = np.sqrt(np.mean(raw**2, axis=0))
    if np.any(size == 0) or np.linalg.matrix_rank(raw / size) <= k:
        raise PlantError(f"{response}: predictors {', '.join(names)} are not independent")
    result: Any = sm.OLS(y, raw / size).fit()
    found = []
    for j, name in enumerate(["Constant", *names]):
        coef, stdev = result.params[j] / size[j], result.bse[j] / size[j]
        found.append(
            Predictor(name, float(coef), float(stdev), float(result.tvalues[j]),
                      float(result.pvalues[j]))
        )  # fmt: skip
    error = float(result.ssr)
    total = float(result.centered_tss)
    dof = n - k - 1
    rows = (
        Source("Regression", k, total - error, (total - error) / k,
               float(result.fvalue), float(result.f_pvalue)),
        Source("Error", dof, error, error / dof, np.nan, np.nan),
        Source("Total", n - 1, total, np.nan, np.nan, np.nan),
    )  # fmt: skip
    return FullRegression(
        response, tuple(found), float(np.sqrt(error / dof)),
        100 * float(result.rsquared), 100 * float(result.rsquared_adj), rows,
    )  # fmt: skip


def best_subsets(y: Array, candidates: Mapping[str, Array], per_size: int = 2) -> list[Subset]:
    """The best subsets of candidate predictors, `per_size` of each size, as in Minitab.

    C-p is Mallows' Cp, relative to the regression on all candidates.
    """
    names = list(candidates)
    n = len(y)
    every = full_regression("y", y, candidates)
    variance = every.s**2
    found = []
    for count in range(1, len(names) + 1):
        if n <= count + 1:
            break
        subsets = []
        for chosen in combinations(names, count):
            r = full_regression("y", y, {k: candidates[k] for k in chosen})
            cp = r.anova[1].ss / variance - (n - 2 * (count + 1))
            subsets.append(Subset(count, r.r2_percent, r.r2adj_percent, cp, r.s, chosen))
        subsets.sort(key=lambda x: (-x.r2_percent, x.names))
        found += subsets[:per_size]
    return found


def subsets_text(rows: list[Subset], candidates: list[str]) -> str:
    """The table in the format of the thesis: a column of marks for each candidate."""
    widths = [max(len(c), 1) + 2 for c in candidates]
    head = f"{'Vars':>4}{'R-sq':>8}{'adj':>8}{'C-p':>10}{'s':>12}"
    lines = [head + "".join(f"{c:>{w}}" for c, w in zip(candidates, widths, strict=True))]
    for row in rows:
        line = f"{row.vars:>4}{row.r2_percent:>8.1f}{row.r2adj_percent:>8.1f}"
        line += f"{row.cp:>10.1f}{row.s:>12.5g}"
        for c, w in zip(candidates, widths, strict=True):
            line += f"{'X' if c in row.names else '':>{w}}"
        lines.append(line)
    return "\n".join(lines)


def regression_of(model: Model, points: Points) -> tuple[FullRegression, dict[str, Array]]:
    """The full regression of a model that is a sum of terms, in the units of its parameters.

    Returns the regression and its columns (for best subsets). Raises `PlantError` for a model that
    is not such a sum, or has no constant.
    """
    if not isinstance(model.law, TermLaw):
        raise PlantError(
            f"model {model.name} is not a sum of terms: regression tables are for the single black "
            "boxes and quasi-static models (such as black-box-high)"
        )
    rows = model.law.jacobian(model.q, points.pressure_pa, points.length_m, points.temperature_c)
    columns, constant = {}, ""
    for parameter, term, row in zip(model.parameters, model.law.terms, rows, strict=True):
        if term == Term():
            constant = parameter.name
        else:
            columns[parameter.name] = np.asarray(row * parameter.to_si)
    if not constant:
        raise PlantError(f"model {model.name} has no constant term")
    return full_regression("force_n", points.force_n, columns), columns
