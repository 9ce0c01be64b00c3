"""Geometry of an x-y chart. The viewer has plots over time only, so charts are drawings.

A drawing has WIDTH x HEIGHT units with y pointing down: frame, grid, tick labels, points, and a
label at the end of each curve as legend. This module calculates positions; it draws nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from daq.live.layout import PALETTE, Axis, Colour

Floats = npt.NDArray[np.float64]

WIDTH, HEIGHT = 1000.0, 440.0
LABEL_GAP = 34.0  # minimum vertical distance between curve labels
LABEL_LEFT = 22.0  # distance of a curve's label from its end
POINTS_PER_CURVE = 5_000  # limit for one curve
LETTER = 10.5  # approximate width of a letter of a centred title
TITLE_LEFT = -85.0  # left limit of the y axis title
OVERSHOOT = 0.03  # share of the axis by which a point may exceed the frame before the axis grows


def nice_ticks(low: float, high: float, about: int = 6) -> Floats:
    """Ticks that cover [low, high], with steps of 1, 2 or 5 times a power of ten."""
    span = high - low
    if not (math.isfinite(span) and span > 0):
        return np.array([low, low + 1.0]) if math.isfinite(low) else np.array([0.0, 1.0])
    raw = span / about
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(m * power for m in (1.0, 2.0, 5.0, 10.0) if m * power >= raw * 0.999)
    first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
    return np.arange(first, last + 1, dtype=np.float64) * step


def log_ticks(low: float, high: float) -> Floats:
    """Ticks in log10 that cover [low, high]: decades; below three decades also 2 and 5 times."""
    if not (math.isfinite(high - low) and high > low):
        return nice_ticks(low, high)
    between = [0.0] if high - low > 3.0 else [0.0, math.log10(2.0), math.log10(5.0)]
    decades = range(math.floor(low) - 1, math.ceil(high) + 2)
    every = np.array([k + part for k in decades for part in between])
    first = np.flatnonzero(every <= low + 1e-9)[-1]
    last = np.flatnonzero(every >= high - 1e-9)[0]
    return np.asarray(every[first : last + 1], dtype=np.float64)


def ticks_of(axis: Axis, low: float, high: float) -> Floats:
    """Ticks of an axis that cover [low, high]."""
    return log_ticks(low, high) if axis.log10 else nice_ticks(low, high)


@dataclass
class Curve:
    """Points with one label, in order of arrival."""

    colour: Colour
    x: list[float] = field(default_factory=list)
    y: list[float] = field(default_factory=list)


@dataclass(frozen=True)
class Drawing:
    """All elements of the chart, in drawing units."""

    strips: list[Floats]  # frame first, then grid lines
    tick_at: Floats  # (n, 2)
    tick_text: list[str]
    title_at: Floats  # (2, 2): x title, y title
    title_text: list[str]


class Chart:
    """An x-y chart whose axes grow with its points; ``Axis`` gives titles and minimum ranges."""

    def __init__(self, x_axis: Axis, y_axis: Axis) -> None:
        self.axes = (x_axis, y_axis)
        self.curves: dict[str, Curve] = {}
        self._ticks = [ticks_of(a, a.low, a.high) for a in self.axes]

    def add(self, label: str, x: Floats, y: Floats) -> bool:
        """Add points; True if an axis has grown, so that everything must be drawn again."""
        if label not in self.curves:
            self.curves[label] = Curve(PALETTE[len(self.curves) % len(PALETTE)])
        curve = self.curves[label]
        good = np.isfinite(x) & np.isfinite(y)
        curve.x.extend(x[good].tolist())
        curve.y.extend(y[good].tolist())
        del curve.x[:-POINTS_PER_CURVE], curve.y[:-POINTS_PER_CURVE]
        grown = False
        for k, values in enumerate((x[good], y[good])):
            ticks = self._ticks[k]
            slack = OVERSHOOT * (ticks[-1] - ticks[0])
            if len(values) and (
                values.min() < ticks[0] - slack or values.max() > ticks[-1] + slack
            ):
                low, high = min(ticks[0], values.min()), max(ticks[-1], values.max())
                self._ticks[k] = ticks_of(self.axes[k], low, high)
                grown = True
        return grown

    def place(self, x: Floats, y: Floats) -> Floats:
        """(n, 2) positions in the drawing."""
        tx, ty = self._ticks
        px = (np.asarray(x) - tx[0]) / (tx[-1] - tx[0]) * WIDTH
        py = HEIGHT - (np.asarray(y) - ty[0]) / (ty[-1] - ty[0]) * HEIGHT
        return np.column_stack((px, py))

    def line(self, label: str) -> Floats:
        """(n, 2) positions of the curve's line through the means of points with nearly equal x."""
        curve = self.curves[label]
        order = np.argsort(curve.x, kind="stable")
        x, y = np.asarray(curve.x)[order], np.asarray(curve.y)[order]
        near = 0.015 * (self._ticks[0][-1] - self._ticks[0][0])
        group = np.concatenate(([0], np.cumsum(np.diff(x) > near)))
        count = np.bincount(group)
        mean_x, mean_y = np.bincount(group, x) / count, np.bincount(group, y) / count
        return self.place(mean_x, mean_y)

    def label_positions(self) -> tuple[list[str], Floats]:
        """Labels and the positions of their centres: right of each curve's end, at a distance."""
        ends = {name: self.line(name)[-1] for name, c in self.curves.items() if c.x}
        names = sorted(ends, key=lambda name: float(ends[name][1]))
        at = np.array(
            [[ends[n][0] + LABEL_LEFT + LETTER * len(n) / 2, ends[n][1] - 15.0] for n in names]
        ).reshape(-1, 2)
        for k in range(1, len(at)):
            at[k, 1] = max(at[k, 1], at[k - 1, 1] + LABEL_GAP)
        return names, at

    def drawing(self) -> Drawing:
        """Frame, grid and texts for the current axes."""
        frame = np.array([[0, 0], [0, HEIGHT], [WIDTH, HEIGHT], [WIDTH, 0], [0, 0]], dtype=float)
        tx, ty = self._ticks
        at_x = self.place(tx, np.full(len(tx), ty[0]))
        at_y = self.place(np.full(len(ty), tx[0]), ty)
        strips = [frame]
        strips += [np.array([[p[0], 0.0], [p[0], HEIGHT]]) for p in at_x[1:-1]]
        strips += [np.array([[0.0, p[1]], [WIDTH, p[1]]]) for p in at_y[1:-1]]
        tick_at = np.concatenate((at_x + np.array([0.0, 18.0]), at_y - np.array([34.0, 15.0])))
        title_x = max(20.0, TITLE_LEFT + LETTER * len(self.axes[1].title) / 2)
        return Drawing(
            strips=strips,
            tick_at=tick_at,
            tick_text=[
                f"{float(axis.quantity(v)):.6g}"
                for axis, ticks in zip(self.axes, (tx, ty), strict=True)
                for v in ticks.round(9)
            ],
            title_at=np.array([[WIDTH / 2, HEIGHT + 56.0], [title_x, -62.0]]),
            title_text=[a.title for a in self.axes],
        )
