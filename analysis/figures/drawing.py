"""How figures are drawn: style, colours, names at the curves' ends, output."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MARKERS = "osD^vPX"
INK = "#222222"
QUIET = "#8a8a8a"
MEASURED = "#0072B2"
SET = "#E69F00"
COVERAGE = 2.0
"""Error bars are expanded uncertainties, k = 2."""

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
    "xtick.color": INK,
    "ytick.color": INK,
    "legend.frameon": False,
    "svg.fonttype": "path",
    "svg.hashsalt": "pamrig",
    "figure.dpi": 100.0,
}


def as_svg(figure: Figure) -> bytes:
    """The figure as SVG with glyphs as paths and no date: the same bytes for the same data."""
    from matplotlib import rc_context

    buffer = io.BytesIO()
    with rc_context(STYLE):
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return buffer.getvalue()


def as_png(figure: Figure, dpi: int = 150) -> bytes:
    """The figure as PNG."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi)
    return buffer.getvalue()


def style() -> Any:
    """The house style for as long as the context lasts."""
    import matplotlib as mpl

    return mpl.rc_context(STYLE)


def new_figure(
    width: float, height: float, rows: int = 1, columns: int = 1, sharex: bool = False
) -> tuple[Figure, Any]:
    """A figure that belongs to no window and no global state."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns, sharex=sharex)


def sequence(count: int) -> list[Any]:
    """Colours in order of length that keep their order without colour vision (most of viridis)."""
    import matplotlib as mpl

    return list(mpl.colormaps["viridis"](np.linspace(0.02, 0.86, max(count, 1))))


def directions_legend(axes: Axes, what: str, place: str) -> None:
    """Say which marker stands for ``what`` rising and which for falling."""
    from matplotlib.lines import Line2D

    looks: tuple[dict[str, Any], ...] = (
        {"label": f"{what} rising"},
        {"label": f"{what} falling", "mfc": "white", "ls": "--"},
    )
    handles = [Line2D([], [], color=INK, marker="o", markersize=4, **look) for look in looks]
    axes.legend(handles=handles, loc=place)


def labels_at_right(axes: Axes, ends: list[tuple[float, float, str, Any]], heading: str) -> None:
    """Name each curve where it ends, moved apart so that no two names overlap."""
    ends = sorted((end for end in ends if np.isfinite(end[:2]).all()), key=lambda end: end[1])
    if not ends:
        return
    low, high = axes.get_ylim()
    height_points = axes.figure.bbox.height / axes.figure.dpi * 72.0 * 0.8
    gap = (high - low) * 9.5 / height_points
    places = spread([end[1] for end in ends], gap)
    for (x, y, label, colour), place in zip(ends, places, strict=True):
        axes.annotate(
            label,
            xy=(x, y),
            xytext=(1.035, place),
            textcoords=("axes fraction", "data"),
            color=INK,
            fontsize=8,
            va="center",
            annotation_clip=False,
            arrowprops={
                "arrowstyle": "-",
                "color": colour,
                "linewidth": 0.5,
                "shrinkA": 1,
                "shrinkB": 3,
            },
        )
    axes.annotate(
        heading,
        xy=(1.035, places[-1] + gap * 1.2),
        xycoords=("axes fraction", "data"),
        fontsize=8,
        color=INK,
        va="center",
        annotation_clip=False,
    )


def spread(wanted: list[float], gap: float) -> list[float]:
    """Places at least ``gap`` apart and in order, as near the wanted ones as that allows."""
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
