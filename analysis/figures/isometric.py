"""Figures of an isometric test: force against pressure (Figure 4-9), regressions, residuals."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from analysis.figures.drawing import (
    COVERAGE,
    INK,
    MARKERS,
    MEASURED,
    QUIET,
    SET,
    directions_legend,
    labels_at_right,
    new_figure,
    sequence,
    style,
)
from analysis.regression.force_lines import LengthLaw, LengthLine, length_groups

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Floats = npt.NDArray[np.float64]


def force_figure(table: pd.DataFrame) -> Figure:
    """Force against pressure, one curve a length (the form of the thesis's Figure 4-9).

    Up is drawn filled with a solid line, down open with a dashed one; repeats are joined by
    their mean; bars are expanded uncertainties (k = 2), hidden where smaller than the marker.
    """
    groups = length_groups(table)
    colours = sequence(len(groups))
    with style():
        figure, axes = new_figure(7.2, 4.9)
        ends: list[tuple[float, float, str, Any]] = []
        directions: set[str] = set()
        for index, (length_mm, _, rows) in enumerate(groups):
            marker = MARKERS[index % len(MARKERS)]
            label = f"{length_mm:.2f}".rstrip("0").rstrip(".")
            last = (math.nan, math.nan)
            for direction, part in rows.groupby("direction", sort=True):
                down = direction == "down"
                directions.add(str(direction))
                last = _curve(axes, part, colours[index], marker, down)
            if all(math.isfinite(value) for value in last):
                ends.append((*last, label, colours[index]))
        axes.axhline(0.0, color=QUIET, linewidth=0.8)
        axes.set_xlabel("pressure (kPa gauge)")
        axes.set_ylabel("force (N)")
        axes.margins(y=0.06)
        labels_at_right(axes, ends, "length (mm)")
        if "down" in directions:
            directions_legend(axes, "pressure", "upper left")
    return figure


def _curve(
    axes: Axes, rows: pd.DataFrame, colour: Any, marker: str, down: bool
) -> tuple[float, float]:
    """Draw the points of one length and direction; return where the curve ends on the right."""
    points = rows.dropna(subset=["pressure_kpa", "force_n"])
    if not len(points):
        return math.nan, math.nan
    axes.errorbar(
        points["pressure_kpa"],
        points["force_n"],
        xerr=_bars(points, "u_pressure_kpa"),
        yerr=_bars(points, "u_force_n"),
        fmt=marker,
        color=colour,
        markersize=5.4 if down else 3.6,  # an open marker shows around a filled one on it
        markerfacecolor="white" if down else colour,
        markeredgewidth=0.9,
        elinewidth=0.7,
        ecolor=colour,
        zorder=3 if down else 4,
    )
    nominal = points["set_pressure_kpa"].fillna(points["pressure_kpa"])
    mean = points[["pressure_kpa", "force_n"]].astype(float).groupby(nominal).mean().sort_index()
    axes.plot(
        mean["pressure_kpa"],
        mean["force_n"],
        color=colour,
        linewidth=1.1,
        linestyle="--" if down else "-",
        zorder=2,
    )
    return float(mean["pressure_kpa"].iloc[-1]), float(mean["force_n"].iloc[-1])


def regression_figure(
    lines: list[LengthLine],
    law: LengthLaw | None,
    printed: tuple[tuple[float, float], tuple[float, float]] | None = None,
) -> Figure:
    """Gradient and intercept against length with their lines (Equations 4-34 and 4-35).

    Args:
        lines: first-stage regressions of one temperature.
        law: second stage drawn as a line, if there is one.
        printed: (slope, constant) of the thesis's two equations, drawn dotted beside it.
    """
    length = np.array([line.length_mm for line in lines])
    panels = (
        ("gradient", "gradient (N/kPa)", "gradient_n_per_kpa", "u_gradient"),
        ("intercept", "intercept (N)", "intercept_n", "u_intercept"),
    )
    with style():
        figure, axes_pair = new_figure(7.2, 3.2, columns=2)
        for index, (name, label, column, u_name) in enumerate(panels):
            axes = axes_pair[index]
            values = np.array([getattr(line, column) for line in lines])
            fit_u = np.array([getattr(line, f"{u_name}_fit") for line in lines])
            cal_u = np.nan_to_num([getattr(line, f"{u_name}_cal") for line in lines])
            bars = COVERAGE * np.hypot(np.nan_to_num(fit_u), cal_u)
            axes.errorbar(
                length,
                values,
                yerr=bars,
                fmt="o",
                color=MEASURED,
                markersize=4,
                elinewidth=0.8,
                capsize=2,
                label="each length, k = 2",
                zorder=3,
            )
            if law is not None:
                fit = getattr(law, name)
                axes.plot(
                    length,
                    fit.slope * length + fit.intercept,
                    color=INK,
                    linewidth=1.2,
                    label=f"{_minus(fit.slope)} L {_signed(fit.intercept)}",
                )
            if printed is not None:
                slope, constant = printed[index]
                axes.plot(
                    length,
                    slope * length + constant,
                    color=SET,
                    linewidth=1.6,
                    linestyle=":",
                    label="as printed in the thesis",
                )
            axes.set_xlabel("length L (mm)")
            axes.set_ylabel(label)
            axes.margins(y=0.15)
            axes.legend(loc="best", fontsize=7.5)
    return figure


def residual_figure(
    table: pd.DataFrame, lines: list[LengthLine], region: tuple[float, float]
) -> Figure:
    """What each length's straight line leaves over, against pressure."""
    groups = length_groups(table)
    colours = sequence(len(groups))
    with style():
        figure, axes = new_figure(7.2, 3.0)
        ends: list[tuple[float, float, str, Any]] = []
        for index, (length_mm, temperature_c, rows) in enumerate(groups):
            line = _line_of(lines, length_mm, temperature_c)
            if line is None:
                continue
            nominal = rows["set_pressure_kpa"].fillna(rows["pressure_kpa"])
            part = rows[nominal.between(*region)].dropna(subset=["pressure_kpa", "force_n"])
            left = (
                part["force_n"] - line.gradient_n_per_kpa * part["pressure_kpa"] - line.intercept_n
            )
            axes.plot(
                part["pressure_kpa"],
                left,
                MARKERS[index % len(MARKERS)],
                color=colours[index],
                markersize=3.6,
                alpha=0.9,
            )
            mean = left.astype(float).groupby(nominal[part.index]).mean()
            axes.plot(mean.index, mean, color=colours[index], linewidth=0.8, alpha=0.7)
            ends.append(
                (float(mean.index[-1]), float(mean.iloc[-1]), f"{length_mm:g}", colours[index])
            )
        axes.axhline(0.0, color=QUIET, linewidth=0.8)
        axes.set_xlabel("pressure (kPa gauge)")
        axes.set_ylabel("force − line (N)")
        labels_at_right(axes, ends, "length (mm)")
    return figure


def _bars(rows: pd.DataFrame, column: str) -> Floats | None:
    values = rows[column].to_numpy(dtype=np.float64)
    return None if np.isnan(values).all() else COVERAGE * np.nan_to_num(values)


def _line_of(lines: list[LengthLine], length_mm: float, temperature_c: float) -> LengthLine | None:
    for line in lines:
        key = line.set_length_mm if math.isfinite(line.set_length_mm) else line.length_mm
        same_length = abs(key - length_mm) < 0.02
        both = math.isfinite(line.temperature_c) and math.isfinite(temperature_c)
        if same_length and (not both or abs(line.temperature_c - temperature_c) < 1.0):
            return line
    return None


def _minus(value: float) -> str:
    return f"{value:.3g}".replace("-", "−")


def _signed(value: float) -> str:
    return f"{'−' if value < 0 else '+'} {abs(value):.3g}"
