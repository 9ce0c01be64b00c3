"""Figures of several runs: their curves over each other, and control charts."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from analysis.figures.drawing import (
    DOUBLE_COLUMN,
    INK,
    MEASURED,
    QUIET,
    marker,
    new_figure,
    sequence,
    spread,
    style,
)
from analysis.statistics.control_chart import D2

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from analysis.statistics.control_chart import ControlChart

ALARM = "#D55E00"  # Okabe and Ito
LEGEND_MOST = 12
LABELS_MOST = 12
LABEL_PART = 0.09
"""Height of a name at a line, as a part of the axis."""


def overlay_figure(data: Mapping[str, Any]) -> Figure:
    """Means of every run over a setting, and their differences from the mean of all runs.

    Args:
        data: ``curves``: (run number, settings) to (x, mean, expanded uncertainty, difference);
            ``names`` and ``specimens`` by run number; ``y_label`` and ``x_label`` of the axes.
            Runs of one specimen have one colour.
    """
    y_label, x_label = data["y_label"], data["x_label"]
    specimens = list(dict.fromkeys(data["specimens"].values()))
    colours = dict(zip(specimens, sequence(len(specimens)), strict=True))
    with style():
        figure, (top, bottom) = new_figure(DOUBLE_COLUMN, 5.4, rows=2, sharex=True)
        labelled: set[int] = set()
        numbers = sorted(data["names"])
        step = _step([x for rows in data["curves"].values() for x, *_ in rows])
        for (number, _), rows in data["curves"].items():
            x, mean, u, difference = (
                np.array(column) for column in zip(*sorted(rows), strict=True)
            )
            colour = colours[data["specimens"][number]]
            sign = marker(numbers.index(number))
            name = None if number in labelled else data["names"][number]
            labelled.add(number)
            top.errorbar(x, mean, yerr=_bars(u), color=colour, marker=sign, markersize=3.4,
                         linewidth=0.9, elinewidth=0.7, label=name)  # fmt: skip
            shift = 0.05 * step * (numbers.index(number) - 0.5 * (len(numbers) - 1))
            bottom.errorbar(x + shift, difference, yerr=_bars(u), color=colour, marker=sign,
                            markersize=3.4, linestyle="", elinewidth=0.7)  # fmt: skip
        bottom.axhline(0.0, color=QUIET, linewidth=0.8)
        top.set_ylabel(y_label)
        bottom.set_ylabel("difference from\nthe mean of all runs" + _unit(y_label))
        bottom.set_xlabel(x_label)
        if len(numbers) <= LEGEND_MOST:
            figure.legend(loc="outside upper center", ncols=3, fontsize=8, title_fontsize=8,
                          title="run: specimen, date")  # fmt: skip
        figure.align_ylabels([top, bottom])
    return figure


def _unit(label: str) -> str:
    return f" {label[label.index('(') :]}" if "(" in label else ""


def _bars(u: npt.NDArray[np.float64]) -> npt.NDArray[np.float64] | None:
    return np.nan_to_num(u) if np.isfinite(u).any() else None


def _step(places: Sequence[float]) -> float:
    """Smallest distance of two settings; bars of several runs stand beside each other in it."""
    apart = np.diff(np.unique(places))
    return float(apart.min()) if len(apart) else 1.0


def chart_figure(
    chart: ControlChart, labels: Sequence[str], u: npt.NDArray[np.float64], y_label: str
) -> Figure:
    """Control chart: values with their uncertainty, centre and limits; moving ranges below.

    Args:
        chart: the chart.
        labels: of the values, shape (n,).
        u: expanded uncertainty of each value, shape (n,); NaN: no bar.
        y_label: quantity with its unit.
    """
    places = np.arange(len(chart.values))
    with style():
        figure, (top, bottom) = new_figure(DOUBLE_COLUMN, 4.4, rows=2, sharex=True)
        _limits(top, chart.centre, chart.lower, chart.upper)
        top.errorbar(places, chart.values, yerr=_bars(u), color=MEASURED, marker="o", markersize=4,
                     linewidth=0.9, elinewidth=0.8, capsize=2)  # fmt: skip
        _limits(bottom, D2 * chart.sd, math.nan, chart.range_limit)
        bottom.plot(
            places[1:], chart.ranges, color=MEASURED, marker="o", markersize=4, linewidth=0.9
        )
        wrong = {i for rule, at in chart.alarms.items() for i in at if rule != "range"}
        for axes, at, values in (
            (top, wrong, chart.values),
            (
                bottom,
                set(chart.alarms.get("range", ())),
                np.concatenate(([math.nan], chart.ranges)),
            ),
        ):
            for i in at:
                axes.plot(i, values[i], "o", mfc="none", mec=ALARM, mew=1.6, markersize=10)
        if 0 < chart.base < len(places):
            for axes in (top, bottom):
                axes.axvline(chart.base - 0.5, color=INK, linewidth=0.8, linestyle=":")
        top.set_ylabel(y_label)
        bottom.set_ylabel("moving range" + _unit(y_label))
        bottom.set_ylim(bottom=0.0)
        every = max(1, math.ceil(len(places) / LABELS_MOST))
        bottom.set_xticks(places[::every], [labels[i] for i in places[::every]], fontsize=7.5)
        bottom.set_xlabel("run and its date")
        top.margins(x=0.06)
        _name_limits(top, chart.centre, chart.lower, chart.upper)
        _name_limits(bottom, D2 * chart.sd, math.nan, chart.range_limit)
        figure.align_ylabels([top, bottom])
    return figure


def _limits(axes: Axes, centre: float, lower: float, upper: float) -> None:
    """Lines of the centre and of the limits that there are."""
    axes.axhline(centre, color=INK, linewidth=0.9)
    for value in (lower, upper):
        if math.isfinite(value) and value != centre:
            axes.axhline(value, color=ALARM, linewidth=0.9, linestyle="--")


def _name_limits(axes: Axes, centre: float, lower: float, upper: float) -> None:
    """Names at the right ends of these lines, apart from each other; one name for equal ones."""
    named = [(lower, "lower limit"), (centre, "centre"), (upper, "upper limit")]
    known = [(value, name) for value, name in named if math.isfinite(value)]
    if len({value for value, _ in known}) == 1:
        known = [(centre, "centre and limits" if len(known) > 2 else "centre and limit")]
    low, high = axes.get_ylim()
    gap = (high - low) * LABEL_PART
    for (_, name), place in zip(known, spread([v for v, _ in known], gap), strict=True):
        axes.annotate(name, xy=(1.005, place), xycoords=("axes fraction", "data"), fontsize=7.5,
                      va="center", color=INK, annotation_clip=False)  # fmt: skip
