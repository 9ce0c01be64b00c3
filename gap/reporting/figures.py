"""Figures of a diagnosis: how far the gap falls, where the residual lies before and after."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.figures import drawing
from analysis.figures.drawing import DOUBLE_COLUMN, INK, QUIET
from analysis.reporting.sections import figure_parts
from gap.reporting.empirical import empirical_figure
from gap.reporting.examination import Examination, Field
from gap.reporting.map_figures import courses_figure
from gap.verdict import Share
from plant.arrays import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


BLUE, ORANGE, GREEN = "#0072B2", "#E69F00", "#009E73"  # Okabe and Ito
_WITHOUT = ("axes.linewidth", "axes.grid", "grid.color", "grid.linewidth", "figure.dpi")
STYLE = {key: value for key, value in drawing.STYLE.items() if key not in _WITHOUT}
CELLS = 14


NAMES = {
    "traces": "Measured and predicted", "ladder": "Error step by step",
    "maps": "Residual over pressure and length", "courses": "Courses of the residual",
    "order": "Residual of each trial", "stages": "Share of the gap by stage",
    "empirical": "Empirical term",
}  # fmt: skip
"""Figures of a diagnosis, in the order of the page, and their titles."""


def figures(examined: Examination) -> dict[str, dict[str, Any]]:
    """Figures by name: ``address`` to embed, "" where there is nothing to draw, ``width_mm``."""
    return {name: figure_parts(figure) for name, figure in drawn(examined).items()}


def drawn(examined: Examination) -> dict[str, Figure | None]:
    """Figures by name, None where there is nothing to draw; no wider than two columns."""
    from matplotlib import rc_context

    verdict, field = examined.verdict, examined.field
    with rc_context(STYLE):
        made = {
            "traces": traces(examined),
            "ladder": ladder(examined),
            "maps": maps(field) if field is not None else None,
            "courses": courses_figure(
                examined.courses, bool(verdict.effects) and verdict.status.explained
            ),
            "order": course(field) if field is not None else None,
            "stages": stages(verdict.stages),
            "empirical": empirical_figure(verdict.empirical),
        }
        for figure in made.values():
            if figure is not None:
                width, height = figure.get_size_inches()
                figure.set_size_inches(min(width, DOUBLE_COLUMN), height)
        return made


def ladder(examined: Examination) -> Figure | None:
    """Error at each step, held out if there are several settings, with the floor as a line."""
    gap = examined.verdict.headline_gap
    if gap is None or len(examined.ladder) < 2:
        return None
    figure, axes = _figure(DOUBLE_COLUMN, 0.42 * len(examined.ladder) + 1.0)
    labels = [rung.label for rung in examined.ladder]
    values = [rung.rms for rung in examined.ladder]
    colours = [QUIET, BLUE, *[GREEN] * (len(values) - 2)]
    axes.barh(range(len(values)), values, color=colours, height=0.62)
    for at, value in enumerate(values):
        axes.text(value, at, f" {value:.3g}", va="center", fontsize=8.5)
    axes.set_yticks(range(len(labels)), labels)
    axes.invert_yaxis()
    if gap.floor is not None:
        axes.axvline(gap.floor, color=ORANGE, lw=1.4)
        axes.text(
            gap.floor,
            len(values) - 0.42,
            f" floor {gap.floor:.3g}",
            color=INK,
            va="top",
            fontsize=8.5,
        )
        axes.set_ylim(len(values) - 0.1, -0.6)
    which = f"error held out by {gap.held_out}" if gap.held_out else "error of the fit"
    axes.set_xlabel(f"{which}, {gap.unit} (rms)")
    axes.set_xlim(0.0, 1.14 * max(values))
    return figure


def stages(shares: tuple[Share, ...]) -> Figure | None:
    """Share of the end-to-end gap by stage, with intervals, as a waterfall to the whole."""
    if not shares:
        return None
    figure, axes = _figure(DOUBLE_COLUMN, 0.42 * len(shares) + 1.0)
    start = 0.0
    for at, share in enumerate(shares):
        value = 100.0 * share.share
        axes.barh(at, value, left=start, color=BLUE if value >= 0 else ORANGE, height=0.62)
        low, high = 100.0 * (share.low - share.share), 100.0 * (share.high - share.share)
        axes.errorbar(
            start + value,
            at,
            xerr=[[max(-low, 0.0)], [max(high, 0.0)]],
            color=INK,
            lw=1.0,
            capsize=3,
        )
        axes.text(
            start + value + max(high, 0.0),
            at,
            f"  {round(value) + 0:d} %",
            va="center",
            fontsize=8.5,
        )
        start += value
    axes.set_yticks(range(len(shares)), [share.stage for share in shares])
    axes.set_ylim(len(shares) - 0.4, -0.6)
    axes.axvline(0.0, color=QUIET, lw=0.8)
    axes.set_xlabel("share of the gap, % (bars: 95 % interval)")
    axes.margins(x=0.15)
    return figure


def traces(examined: Examination) -> Figure | None:
    """Measured and predicted in a few trials, before and after what was found."""
    shown, field = examined.traces, examined.field
    if not shown or field is None:
        return None
    from matplotlib import pyplot

    made = pyplot.subplots(
        1, len(shown), figsize=(DOUBLE_COLUMN, 2.7), layout="constrained", squeeze=False
    )
    figure: Figure = made[0]
    grid = made[1]
    pyplot.close(figure)
    explained = _explained(field)
    for axes, trace in zip(grid[0], shown, strict=True):
        mark = "o" if trace.settled else ""
        axes.plot(trace.x, trace.measured, color=INK, lw=1.2, marker=mark, ms=3, label="measured")
        axes.plot(trace.x, trace.recalibrated, color=BLUE, lw=1.2, ls="--", label="recalibrated")
        if explained:
            axes.plot(
                trace.x, trace.after, color=GREEN, lw=2.2, ls=":", label="with what was found"
            )
        # The name of a trial of a run is wider than one of three panels.
        axes.set_title(textwrap.fill(f"trial {trace.trial}", _TITLE_WIDTH), fontsize=9.5)
        axes.set_xlabel("pressure, kPa" if trace.settled else "time, s")
    grid[0][0].set_ylabel(f"{_QUANTITY.get(field.block, field.block)}, {field.unit}")
    lines, labels = grid[0][0].get_legend_handles_labels()
    figure.legend(lines, labels, loc="outside upper center", fontsize=8, ncols=3)
    return figure


def _explained(field: Field) -> bool:
    """False where nothing was found that the verdict stands by: after is as before."""
    return not np.array_equal(field.before, field.after)


_TITLE_WIDTH = 26
"""Characters in a line above a panel."""
_QUANTITY = {"camera": "length shown"}


def maps(field: Field) -> Figure | None:
    """Mean residual over pressure and length, before and after, on one scale of colour."""
    titles = ("recalibrated", "with what was found")[: 1 + _explained(field)]
    cells = [_cells(field, values) for values in (field.before, field.after)[: len(titles)]]
    shown = [cell for cell in cells if cell is not None]
    if len(shown) < len(titles):
        return None
    from matplotlib import pyplot

    most = float(np.nanpercentile(np.abs(shown[0][2]), 98)) or 1.0
    made = pyplot.subplots(
        1, len(shown), figsize=(0.6 * DOUBLE_COLUMN if len(shown) == 1 else DOUBLE_COLUMN, 3.1),
        sharey=True, layout="constrained", squeeze=False,
    )  # fmt: skip
    figure: Figure = made[0]
    axes: Sequence[Axes] = list(made[1][0])
    pyplot.close(figure)
    for axis, (edges, heights, mean), title in zip(axes, shown, titles, strict=True):
        image = axis.pcolormesh(edges, heights, mean.T, cmap="RdBu_r", vmin=-most, vmax=most)
        axis.set_title(title, fontsize=9.5)
        axis.set_xlabel("pressure, kPa")
        axis.set_facecolor("#d6d6d6")
    axes[0].set_ylabel("length, mm")
    bar = figure.colorbar(image, ax=axes, shrink=0.9)
    bar.set_label(f"measured − predicted, {field.unit}")
    return figure


def course(field: Field) -> Figure | None:
    """Mean and spread of the residual in each trial, in the order of measurement.

    Trials of which nothing is compared are left out.
    """
    orders = np.unique(field.order[np.isfinite(field.order) & (field.weight > 0.0)])
    if len(orders) < 3:
        return None
    figure, axes = _figure(DOUBLE_COLUMN, 2.4)
    for values, colour, marker, label, shift in (
        (field.before, BLUE, "o", "recalibrated", -0.12),
        (field.after, GREEN, "s", "with what was found", 0.12),
    )[: 1 + _explained(field)]:
        mean, spread = [], []
        for order in orders:
            here = field.order == order
            middle = float(np.average(values[here], weights=field.weight[here]))
            rest = np.average((values[here] - middle) ** 2, weights=field.weight[here])
            mean.append(middle)
            spread.append(float(np.sqrt(rest)))
        axes.errorbar(
            orders + shift, mean, yerr=spread, fmt=marker, ms=4, lw=0.9, color=colour, label=label
        )
    axes.axhline(0.0, color=QUIET, lw=0.8)
    axes.set_xlabel("trial, in order of measurement")
    axes.set_ylabel(f"residual, {field.unit}")
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), fontsize=8, ncols=2)
    return figure


def _cells(field: Field, values: Array) -> tuple[Array, Array, Array] | None:
    """Edges over pressure and length and the mean in each cell, NaN where nothing was measured."""
    use = np.isfinite(field.pressure_kpa) & np.isfinite(field.length_mm) & np.isfinite(values)
    if use.sum() < 8:
        return None
    p, length, v, w = (a[use] for a in (field.pressure_kpa, field.length_mm, values, field.weight))
    across, up = _edges(p), _edges(length)
    total, _, _ = np.histogram2d(p, length, [across, up], weights=w * v)
    weight, _, _ = np.histogram2d(p, length, [across, up], weights=w)
    with np.errstate(invalid="ignore", divide="ignore"):
        return across, up, np.where(weight > 0.0, total / weight, np.nan)


def _edges(x: Array) -> Array:
    low, high = float(x.min()), float(x.max())
    if high - low < 1e-9:
        low, high = low - 0.5, high + 0.5
    return np.linspace(low, high, CELLS + 1)


def _figure(width: float, height: float) -> tuple[Figure, Axes]:
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(width, height), layout="constrained")
    pyplot.close(figure)
    return figure, axes
