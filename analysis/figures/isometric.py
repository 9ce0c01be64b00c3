"""Figures of an isometric test: force against pressure (Figure 4-9), regressions, residuals."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.figures.drawing import (
    COVERAGE,
    DOUBLE_COLUMN,
    INK,
    MEASURED,
    QUIET,
    SET,
    CurveEnds,
    curve,
    curves_figure,
    directions_legend,
    labels_at_right,
    marker,
    new_figure,
    sequence,
    style,
)
from analysis.figures.wording import signed
from analysis.regression.force_lines import LengthLaw, LengthLine, length_groups

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure


def force_figure(table: pd.DataFrame) -> Figure:
    """Force against pressure, one curve per length (as in Figure 4-9 of the thesis).

    Rising pressure: filled markers, solid line. Falling pressure: open markers, dashed line. The
    line joins the means of repeats. Bars are expanded uncertainties (k = 2).
    """
    groups = length_groups(table)

    def draw(axes: Any, colours: list[Any], ends: CurveEnds) -> None:
        for index, (length_mm, _, rows) in enumerate(groups):
            end = (math.nan, math.nan)
            for direction, part in rows.groupby("direction", sort=True):
                pressures = part["set_pressure_kpa"].fillna(part["pressure_kpa"])
                end = curve(
                    axes, part, ("pressure_kpa", "force_n"), pressures, colours[index], index,
                    down=direction == "down",
                )  # fmt: skip
            ends.append((*end, f"{length_mm:.2f}".rstrip("0").rstrip("."), colours[index]))
        if (table["direction"] == "down").any():
            directions_legend(axes, "upper left")

    return curves_figure(len(groups), "pressure (kPa gauge)", "force (N)", "length (mm)", draw)


def regression_figure(
    lines: list[LengthLine],
    law: LengthLaw | None,
    printed: tuple[tuple[float, float], tuple[float, float]] | None = None,
) -> Figure:
    """Gradient and intercept against length with their lines (Equations 4-34 and 4-35).

    Args:
        lines: first-stage regressions of one temperature.
        law: second stage, drawn as a line.
        printed: (slope, constant) of the two equations of the thesis, drawn dotted.
    """
    length = np.array([line.length_mm for line in lines])
    panels = (
        ("gradient", "gradient (N/kPa)", "gradient_n_per_kpa", "u_gradient"),
        ("intercept", "intercept (N)", "intercept_n", "u_intercept"),
    )
    with style():
        figure, axes_pair = new_figure(DOUBLE_COLUMN, 3.2, columns=2)
        for index, (name, label, column, u_name) in enumerate(panels):
            axes = axes_pair[index]
            values = np.array([getattr(line, column) for line in lines])
            fit_u = np.array([getattr(line, f"{u_name}_fit") for line in lines])
            cal_u = np.nan_to_num([getattr(line, f"{u_name}_cal") for line in lines])
            axes.errorbar(
                length, values, yerr=COVERAGE * np.hypot(np.nan_to_num(fit_u), cal_u), fmt="o",
                color=MEASURED, markersize=4, elinewidth=0.8, capsize=2, zorder=3,
                label="each length, k = 2",
            )  # fmt: skip
            if law is not None:
                fit = getattr(law, name)
                slope = f"{fit.slope:.3g}".replace("-", "−")
                axes.plot(
                    length, fit.slope * length + fit.intercept, color=INK, linewidth=1.2,
                    label=f"{slope} L {signed(fit.intercept, '.3g')}",
                )  # fmt: skip
            if printed is not None:
                slope_printed, constant = printed[index]
                axes.plot(
                    length, slope_printed * length + constant, color=SET, linewidth=1.6,
                    linestyle=":", label="as printed in the thesis",
                )  # fmt: skip
            axes.set_xlabel("length L (mm)")
            axes.set_ylabel(label)
            axes.margins(y=0.15)
            axes.legend(loc="best", fontsize=7.5)
    return figure


def residual_figure(
    table: pd.DataFrame, lines: list[LengthLine], region: tuple[float, float]
) -> Figure:
    """Residuals of the straight line of each length, against pressure."""
    groups = length_groups(table)
    colours = sequence(len(groups))
    with style():
        figure, axes = new_figure(DOUBLE_COLUMN, 3.0)
        ends: CurveEnds = []
        for index, (length_mm, temperature_c, rows) in enumerate(groups):
            line = _line_of(lines, length_mm, temperature_c)
            if line is None:
                continue
            colour = colours[index]
            nominal = rows["set_pressure_kpa"].fillna(rows["pressure_kpa"])
            part = rows[nominal.between(*region)].dropna(subset=["pressure_kpa", "force_n"])
            residual = (
                part["force_n"] - line.gradient_n_per_kpa * part["pressure_kpa"] - line.intercept_n
            )
            axes.plot(
                part["pressure_kpa"], residual, marker(index), color=colour, markersize=3.6,
                alpha=0.9,
            )  # fmt: skip
            mean = residual.astype(float).groupby(nominal[part.index]).mean()
            axes.plot(mean.index, mean, color=colour, linewidth=0.8, alpha=0.7)
            ends.append((float(mean.index[-1]), float(mean.iloc[-1]), f"{length_mm:g}", colour))
        axes.axhline(0.0, color=QUIET, linewidth=0.8)
        axes.set_xlabel("pressure (kPa gauge)")
        axes.set_ylabel("force − line (N)")
        labels_at_right(axes, ends, "length (mm)")
    return figure


def _line_of(lines: list[LengthLine], length_mm: float, temperature_c: float) -> LengthLine | None:
    for line in lines:
        key = line.set_length_mm if math.isfinite(line.set_length_mm) else line.length_mm
        both = math.isfinite(line.temperature_c) and math.isfinite(temperature_c)
        if abs(key - length_mm) < 0.02 and (
            not both or abs(line.temperature_c - temperature_c) < 1.0
        ):
            return line
    return None
