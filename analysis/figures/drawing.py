"""Drawing of figures: style, colours, curves with error bars, labels at their ends, output."""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

SINGLE_COLUMN = 88.0 / 25.4
DOUBLE_COLUMN = 180.0 / 25.4
"""Widths of a figure in a paper of one column and of two, in inches."""
MARKERS = "osD^vPX"
DASHES = ("-", "--", ":", "-.")
INK = "#222222"
QUIET = "#8a8a8a"
MEASURED = "#0072B2"
SET = "#E69F00"
COVERAGE = 2.0
"""Coverage factor: error bars are expanded uncertainties, k = 2."""

CurveEnds = list[tuple[float, float, str, Any]]
"""Right ends of curves: x, y, label, colour."""

STYLE: dict[str, Any] = {
    "font.size": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": QUIET,
    "axes.labelcolor": INK,
    "axes.linewidth": 0.8,
    "axes.grid": True,
    "grid.color": "#e6e6e6",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "axes.formatter.useoffset": False,
    "axes.formatter.limits": (-5, 6),
    "xtick.color": INK,
    "ytick.color": INK,
    "legend.frameon": False,
    "svg.fonttype": "path",
    "svg.hashsalt": "pamrig",
    "figure.dpi": 100.0,
}


def as_svg(figure: Figure, text: bool = False) -> bytes:
    """The figure as SVG without a date. Equal data give equal bytes.

    Args:
        figure: the figure.
        text: letters stay text, for a program that edits the file; otherwise they are paths and
            look the same everywhere.
    """
    from matplotlib import rc_context

    buffer = io.BytesIO()
    with rc_context({**STYLE, "svg.fonttype": "none" if text else "path"}):
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return buffer.getvalue()


def as_pdf(figure: Figure) -> bytes:
    """The figure as PDF with its fonts embedded, letters as text, without a date."""
    from matplotlib import rc_context

    buffer = io.BytesIO()
    with rc_context({**STYLE, "pdf.fonttype": 42}):
        figure.savefig(buffer, format="pdf", metadata={"CreationDate": None})
    return buffer.getvalue()


def as_png(figure: Figure, dpi: int = 150) -> bytes:
    """The figure as PNG."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi)
    return buffer.getvalue()


def style() -> Any:
    """Context manager that sets the style of all figures."""
    import matplotlib as mpl

    return mpl.rc_context(STYLE)


_NARROW: ContextVar[bool] = ContextVar("narrow", default=False)
NARROW_HEIGHT = 0.62
"""Height of a figure in a single column, relative to its height in two."""


@contextmanager
def single_column() -> Iterator[None]:
    """Figures that are drawn in this context fit the single column of a paper."""
    token = _NARROW.set(True)
    try:
        yield
    finally:
        _NARROW.reset(token)


def new_figure(
    width: float, height: float, rows: int = 1, columns: int = 1, sharex: bool = False
) -> tuple[Figure, Any]:
    """A figure without a window and without global state; sizes in inches."""
    if _NARROW.get():
        width, height = SINGLE_COLUMN * width / DOUBLE_COLUMN, NARROW_HEIGHT * height
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns, sharex=sharex)


def plain_decades(axis: Axis) -> None:
    """Plain numbers at a logarithmic axis, between decades at 2 and 5."""
    from matplotlib.ticker import FuncFormatter

    def label(value: float, between: bool) -> str:
        return "" if between and f"{value:e}"[0] not in "25" else f"{value:g}"

    axis.set_major_formatter(FuncFormatter(lambda value, _: label(value, False)))
    axis.set_minor_formatter(FuncFormatter(lambda value, _: label(value, True)))


def sequence(count: int) -> list[Any]:
    """Ordered colours that are also distinguishable without colour vision (from viridis)."""
    import matplotlib as mpl

    return list(mpl.colormaps["viridis"](np.linspace(0.02, 0.86, max(count, 1))))


def marker(index: int) -> str:
    """The marker of a curve."""
    return MARKERS[index % len(MARKERS)]


def bars(rows: pd.DataFrame, column: str) -> npt.NDArray[np.float64] | None:
    """Error bars (k = 2) of a column; None if no uncertainty is known."""
    values = rows[f"u_{column}"].to_numpy(dtype=np.float64)
    return None if np.isnan(values).all() else COVERAGE * np.nan_to_num(values)


def curve(  # noqa: PLR0913 - what a curve may look like, by name
    axes: Axes,
    rows: pd.DataFrame,
    columns: tuple[str, str],
    setting: pd.Series,
    colour: Any,
    index: int,
    *,
    down: bool = False,
    linestyle: str = "-",
    label: str | None = None,
) -> tuple[float, float]:
    """Draw points with error bars, and a line through the means of each setting.

    Args:
        axes: where to draw.
        rows: the points.
        columns: names of x and y.
        setting: nominal value of each row; rows of one value are averaged for the line.
        colour: of points and line.
        index: of the curve, selects the marker.
        down: the pressure was falling: open markers and a dashed line.
        linestyle: of the line if not ``down``.
        label: for the legend.

    Returns:
        The right end of the line, NaN without points.
    """
    points = rows.dropna(subset=list(columns))
    if not len(points):
        return math.nan, math.nan
    x, y = columns
    axes.errorbar(
        points[x], points[y], xerr=bars(points, x), yerr=bars(points, y), fmt=marker(index),
        color=colour, ecolor=colour, elinewidth=0.7, markeredgewidth=0.9, label=label,
        markersize=5.4 if down else 3.6,  # an open marker is visible around a filled one
        markerfacecolor="white" if down else colour, zorder=3 if down else 4,
    )  # fmt: skip
    mean = points[[x, y]].astype(float).groupby(setting[points.index]).mean().sort_index()
    style = "--" if down else linestyle
    axes.plot(mean[x], mean[y], color=colour, linewidth=1.1, linestyle=style, zorder=2)
    return float(mean[x].iloc[-1]), float(mean[y].iloc[-1])


def curves_figure(
    count: int,
    x_label: str,
    y_label: str,
    heading: str,
    draw: Callable[[Axes, list[Any], CurveEnds], None],
    zero_line: bool = True,
) -> Figure:
    """A figure of curves that are labelled at their right ends.

    Args:
        count: number of colours.
        x_label, y_label: axis labels.
        heading: of the labels at the curves.
        draw: draws into the axes with these colours and appends the ends of the curves.
        zero_line: draw the line y = 0.
    """
    with style():
        figure, axes = new_figure(DOUBLE_COLUMN, 4.0)
        ends: CurveEnds = []
        draw(axes, sequence(count), ends)
        if zero_line:
            axes.axhline(0.0, color=QUIET, linewidth=0.8)
        axes.set_xlabel(x_label)
        axes.set_ylabel(y_label)
        axes.margins(y=0.06)
        labels_at_right(axes, ends, heading)
    return figure


def directions_legend(axes: Axes, place: str) -> None:
    """Legend of the markers for rising and falling pressure."""
    from matplotlib.lines import Line2D

    looks: tuple[dict[str, Any], ...] = (
        {"label": "pressure rising"},
        {"label": "pressure falling", "mfc": "white", "ls": "--"},
    )
    handles = [Line2D([], [], color=INK, marker="o", markersize=4, **look) for look in looks]
    axes.legend(handles=handles, loc=place)


def labels_at_right(axes: Axes, ends: CurveEnds, heading: str) -> None:
    """Label each curve at its right end; the labels do not overlap."""
    ends = sorted((end for end in ends if np.isfinite(end[:2]).all()), key=lambda end: end[1])
    if not ends:
        return
    low, high = axes.get_ylim()
    height_points = axes.figure.bbox.height / axes.figure.dpi * 72.0 * 0.8
    gap = (high - low) * 9.5 / height_points
    places = spread([end[1] for end in ends], gap)
    text: dict[str, Any] = {
        "color": INK, "fontsize": 8, "va": "center", "annotation_clip": False,
    }  # fmt: skip
    for (x, y, label, colour), place in zip(ends, places, strict=True):
        arrow = {"arrowstyle": "-", "color": colour, "linewidth": 0.5, "shrinkA": 1, "shrinkB": 3}
        axes.annotate(
            label, xy=(x, y), xytext=(1.035, place), textcoords=("axes fraction", "data"),
            arrowprops=arrow, **text,
        )  # fmt: skip
    top = (1.035, places[-1] + gap * (0.7 + 0.5 * len(heading.splitlines())))
    axes.annotate(heading, xy=top, xycoords=("axes fraction", "data"), **text)


def spread(wanted: list[float], gap: float) -> list[float]:
    """Positions in the same order, at least ``gap`` apart, with the least squared displacement."""
    blocks: list[list[float]] = []  # each: [sum of (wanted - offset), number]
    for value in wanted:
        blocks.append([value, 1.0])
        while len(blocks) > 1:
            (above, n_above), (below, n_below) = blocks[-1], blocks[-2]
            if above / n_above >= below / n_below + n_below * gap:
                break
            blocks[-2:] = [[below + above - n_above * n_below * gap, n_below + n_above]]
    places: list[float] = []
    for total, number in blocks:
        places += [total / number + index * gap for index in range(int(number))]
    return places
