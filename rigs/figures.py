"""Figures of an isometric test: Figure 4-9's form, the regressions, and the raw time line."""

from __future__ import annotations

import io
import math
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from daq.errors import RecordError
from rigs.regression import LengthLaw, LengthLine, length_groups

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from daq.run import Run

Floats = npt.NDArray[np.float64]

MARKERS = "osD^vPX"
INK = "#222222"
QUIET = "#8a8a8a"
MEASURED = "#0072B2"
SET = "#E69F00"
COVERAGE = 2.0
"""Error bars are expanded uncertainties, k = 2."""

_STYLE: dict[str, Any] = {
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


def force_figure(table: pd.DataFrame) -> Figure:
    """Force against pressure, one curve a length (the form of the thesis's Figure 4-9).

    Up is drawn filled with a solid line, down open with a dashed one; repeats are joined by
    their mean; bars are expanded uncertainties (k = 2), hidden where smaller than the marker.
    """
    from matplotlib.lines import Line2D

    groups = length_groups(table)
    colours = _sequence(len(groups))
    with _style():
        figure, axes = _new(7.2, 4.9)
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
        _labels_at_right(axes, ends, "length (mm)")
        if "down" in directions:
            handles = [
                Line2D([], [], color=INK, marker="o", markersize=4, label="pressure rising"),
                Line2D([], [], color=INK, marker="o", markersize=4, mfc="white", ls="--",
                       label="pressure falling"),
            ]
            axes.legend(handles=handles, loc="upper left")
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
        markersize=3.8,
        markerfacecolor="white" if down else colour,
        markeredgewidth=0.9,
        elinewidth=0.7,
        ecolor=colour,
        zorder=3,
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
    with _style():
        figure, axes_pair = _new(7.2, 3.2, columns=2)
        for index, (name, label, column, u_name) in enumerate(panels):
            axes = axes_pair[index]
            values = np.array([getattr(line, column) for line in lines])
            fit_u = np.array([getattr(line, f"{u_name}_fit") for line in lines])
            cal_u = np.nan_to_num([getattr(line, f"{u_name}_cal") for line in lines])
            bars = COVERAGE * np.hypot(np.nan_to_num(fit_u), cal_u)
            axes.errorbar(
                length, values, yerr=bars, fmt="o", color=MEASURED, markersize=4, elinewidth=0.8,
                capsize=2, label="each length, k = 2", zorder=3,
            )
            if law is not None:
                fit = getattr(law, name)
                axes.plot(length, fit.slope * length + fit.intercept, color=INK, linewidth=1.2,
                          label=f"{_minus(fit.slope)} L {_signed(fit.intercept)}")
            if printed is not None:
                slope, constant = printed[index]
                axes.plot(length, slope * length + constant, color=SET, linewidth=1.6,
                          linestyle=":", label="as printed in the thesis")
            axes.set_xlabel("length L (mm)")
            axes.set_ylabel(label)
            axes.margins(y=0.15)
            axes.legend(loc="best", fontsize=7.5)
    return figure


def residual_figure(table: pd.DataFrame, lines: list[LengthLine], region: tuple[float, float]
                    ) -> Figure:
    """What each length's straight line leaves over, against pressure."""
    groups = length_groups(table)
    colours = _sequence(len(groups))
    with _style():
        figure, axes = _new(7.2, 3.0)
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
            axes.plot(part["pressure_kpa"], left, MARKERS[index % len(MARKERS)], color=colours[index],
                      markersize=3.6, alpha=0.9)
            mean = left.astype(float).groupby(nominal[part.index]).mean()
            axes.plot(mean.index, mean, color=colours[index], linewidth=0.8, alpha=0.7)
            ends.append((float(mean.index[-1]), float(mean.iloc[-1]), f"{length_mm:g}", colours[index]))
        axes.axhline(0.0, color=QUIET, linewidth=0.8)
        axes.set_xlabel("pressure (kPa gauge)")
        axes.set_ylabel("force − line (N)")
        _labels_at_right(axes, ends, "length (mm)")
    return figure


def timeline_figure(run: Run) -> Figure | None:
    """Set-point and measured pressure, force, and when the points were taken; None if no samples.

    Decimated to the lowest and highest value of each bin, so that nothing short is lost.
    """
    try:
        valve, balance = run.samples("valve"), run.samples("balance")
    except RecordError:
        return None
    if not len(valve.get("seq", ())):
        return None
    pressure_cal, force_cal = run.calibration("pressure_kpa"), run.calibration("force_n")
    start_ns = int(valve["host_ns"][0])
    time_s = (valve["host_ns"].astype(np.int64) - start_ns) / 1e9
    pressure = np.asarray(pressure_cal.apply(valve["counts"].astype(np.float64)))
    setpoint = np.asarray(pressure_cal.apply(valve["setpoint_x16"] / 16.0))
    with _style():
        figure, (top, bottom) = _new(7.2, 4.2, rows=2, sharex=True)
        top.plot(*_min_max(time_s, setpoint), color=SET, linewidth=1.4, label="set-point")
        top.plot(*_min_max(time_s, pressure), color=MEASURED, linewidth=0.7, label="measured")
        top.set_ylabel("pressure (kPa)")
        if len(balance.get("grams", ())):
            force = np.asarray(force_cal.apply(balance["grams"].astype(np.float64)))
            force_s = (balance["host_ns"].astype(np.int64) - start_ns) / 1e9
            bottom.plot(*_min_max(force_s, force), color=MEASURED, linewidth=0.8, label="force")
        bottom.set_ylabel("force (N)")
        bottom.set_xlabel("time since the first sample (s)")
        middles = _point_times(run, valve["seq"], time_s)
        for axes in (top, bottom):
            low, high = axes.get_ylim()
            axes.plot(middles, np.full(len(middles), low), "|", color=INK, markersize=9,
                      label="settled point", clip_on=False)
            axes.set_ylim(low, high)
        top.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, fontsize=8)
        figure.align_ylabels([top, bottom])
    return figure


def as_svg(figure: Figure) -> bytes:
    """The figure as SVG with glyphs as paths and no date: the same bytes for the same data."""
    from matplotlib import rc_context

    buffer = io.BytesIO()
    with rc_context(_STYLE):
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return buffer.getvalue()


def as_png(figure: Figure, dpi: int = 150) -> bytes:
    """The figure as PNG."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi)
    return buffer.getvalue()


def _style() -> Any:
    import matplotlib as mpl

    return mpl.rc_context(_STYLE)


def _new(
    width: float, height: float, rows: int = 1, columns: int = 1, sharex: bool = False
) -> tuple[Figure, Any]:
    """A figure that belongs to no window and no global state."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns, sharex=sharex)


def _sequence(count: int) -> list[Any]:
    """Colours in order of length that stay in order without colour vision (viridis, not its ends)."""
    import matplotlib as mpl

    return list(mpl.colormaps["viridis"](np.linspace(0.02, 0.86, max(count, 1))))


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


def _labels_at_right(
    axes: Axes, ends: list[tuple[float, float, str, Any]], heading: str
) -> None:
    """Name each curve where it ends, moved apart so that no two names overlap."""
    if not ends:
        return
    ends = sorted(ends, key=lambda end: end[1])
    low, high = axes.get_ylim()
    height_points = axes.figure.get_figheight() * 72.0 * 0.8
    gap = (high - low) * 9.5 / height_points
    places = _spread([end[1] for end in ends], gap)
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
            arrowprops={"arrowstyle": "-", "color": colour, "linewidth": 0.5, "shrinkA": 1,
                        "shrinkB": 3},
        )
    axes.annotate(heading, xy=(1.035, places[-1] + gap * 1.2), xycoords=("axes fraction", "data"),
                  fontsize=8, color=INK, va="center", annotation_clip=False)


def _spread(wanted: list[float], gap: float) -> list[float]:
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


def _min_max(x: Floats, y: Floats, bins: int = 1200) -> tuple[Floats, Floats]:
    """First the lowest, then the highest value of each of ``bins`` equal runs of samples."""
    if len(x) <= 2 * bins:
        return x, y
    edges = np.linspace(0, len(x), bins + 1).astype(int)[:-1]
    low, high = np.minimum.reduceat(y, edges), np.maximum.reduceat(y, edges)
    return np.repeat(x[edges], 2), np.column_stack([low, high]).ravel()


def _point_times(run: Run, seq: npt.NDArray[Any], time_s: Floats) -> Floats:
    """Middle of each settled window, s on the figure's axis."""
    middles = []
    for event in run.events:
        if event.get("kind") == "point" and "valve_seq" in event:
            first, end = event["valve_seq"]
            index = int(np.searchsorted(seq, (first + end) // 2))
            if index < len(time_s):
                middles.append(float(time_s[index]))
    return np.array(middles)


def _minus(value: float) -> str:
    return f"{value:.3g}".replace("-", "−")


def _signed(value: float) -> str:
    return f"{'−' if value < 0 else '+'} {abs(value):.3g}"
