"""Draws one measurement: region, threshold mask, profile, fitted edges."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from vision.gray import Box, to_gray
from vision.marker.gap import GapMeasurement

BLUE, ORANGE, GREEN = "#0072B2", "#D55E00", "#009E73"  # Okabe and Ito's palette
SHOWN = 1200  # maximum number of drawn rows and columns
TALLEST = 18.0  # maximum height of the figure, inches


def draw(
    path: Path,
    frame: npt.NDArray[Any],
    *,
    method: str = "edge",
    measured: GapMeasurement | None = None,
    threshold: int = 130,
    roi: Box | None = None,
    flip: bool = True,
    title: str = "",
) -> None:
    """Write the figure to ``path`` (format by suffix: .png, .svg, .pdf).

    Args:
        frame: as given to the measurement.
        method: ``edge`` draws the fitted lines of ``measured``; ``macro`` the scan.
        threshold: NIH grey value; marked pixels are highlighted.
        roi: region of the measurement; for the macro in the flipped frame.
    """
    from matplotlib.figure import Figure
    from matplotlib.patches import Rectangle

    gray = to_gray(frame)
    height, width = gray.shape
    thin = gray[:: 1 + height // SHOWN, :: 1 + width // SHOWN]
    box = roi or (0, 0, width, height)
    if method == "macro" and flip:
        box = (width - box[0] - box[2], box[1], box[2], box[3])
    left, top, wide, high = box
    figure = Figure(
        figsize=(9.0, min(9.0 * height / width * 0.86, TALLEST) + 2.6), layout="constrained"
    )
    upper, lower = figure.subplots(2, 1, height_ratios=[3.0, 1.0], sharex=True)
    upper.imshow(thin, cmap="gray", vmin=0, vmax=255, extent=(0, width, height, 0))
    mask = np.zeros((*thin.shape, 4), np.uint8)
    mask[thin <= 255 - threshold] = (0, 158, 115, 71)
    upper.imshow(mask, extent=(0, width, height, 0))
    upper.add_patch(
        Rectangle((left, top), wide, high, fill=False, edgecolor=ORANGE, lw=1.6, ls="--")
    )
    background = {"facecolor": "white", "alpha": 0.8, "edgecolor": "none", "pad": 1.5}
    upper.text(left + 4, top + 4, "region", color=ORANGE, va="top", fontsize=9, bbox=background)
    upper.set_title("\n".join(textwrap.wrap(title, 95)), fontsize=10)
    upper.set_ylabel("row")
    columns = np.arange(left, left + wide, dtype=np.float64) + 0.5
    part = gray[top : top + high, left : left + wide]
    if method == "macro":
        _draw_macro(upper, lower, part, columns, threshold, flip, (top, high))
    else:
        _draw_edges(upper, lower, gray, box, columns, measured)
    lower.set_xlabel("column (pixels)")
    lower.grid(alpha=0.3)
    lower.plot([], [], "s", color=GREEN, alpha=0.5, label=f"marked: NIH\nvalue {threshold} or more")
    lower.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=8, frameon=False)
    upper.set_xlim(0, width)
    upper.set_ylim(height, 0)
    figure.savefig(path, dpi=110)


def _draw_macro(
    upper: Any,
    lower: Any,
    part: npt.NDArray[Any],
    columns: npt.NDArray[np.float64],
    threshold: int,
    flip: bool,
    rows: tuple[int, int],
) -> None:
    profile = (part <= 255 - threshold).mean(axis=0) * 255.0
    lower.step(columns, profile, where="mid", color=BLUE, label="marked pixels\n(column mean)")
    lower.set_ylabel("NIH grey value")
    scan = profile[::-1] if flip else profile
    hit = np.flatnonzero(scan)
    start = columns[-1] + 0.5 if flip else columns[0] - 0.5
    if len(hit):
        end = start - hit[0] if flip else start + hit[0]
        middle = rows[0] + rows[1] / 2
        _arrow(upper, (start, middle), (end, middle), "->")
        lower.axvline(end, color=ORANGE, ls="--", label=f"first marked\ncolumn: {hit[0]}")


def _draw_edges(
    upper: Any,
    lower: Any,
    gray: npt.NDArray[Any],
    box: Box,
    columns: npt.NDArray[np.float64],
    measured: GapMeasurement | None,
) -> None:
    left, top, wide, high = box
    lines = [] if measured is None else [x for x in (measured.left, measured.right) if x]
    first, last = top, top + high
    if len(lines) == 2:
        common = max(line.top for line in lines), min(line.bottom for line in lines)
        if common[0] < common[1] - 1:
            first, last = common
    part = gray[first : last + 1, left : left + wide]
    slope = float(np.mean([line.slope for line in lines])) if lines else 0.0
    # average along the edges, so that a tilt does not blur the profile
    middle = 0.5 * (first + last)
    profile = np.zeros(wide)
    for k, row in enumerate(part):
        profile += np.interp(columns + slope * (first + k - middle), columns, row)
    profile /= len(part)
    lower.plot(columns, profile, color=BLUE, lw=1.4, label="profile along\nthe edges")
    lower.set_ylabel("grey level")
    for line, style, name in zip(lines, ("-", "--"), ("left edge", "right edge"), strict=False):
        rows = np.array([line.top, line.bottom + 1.0])
        upper.plot([line.x_at(y) for y in rows], rows, color=ORANGE, lw=2, ls=style)
        x = line.x_at(middle)
        lower.axvline(x, color=ORANGE, ls=style, lw=1.4, label=f"{name}\n{x:.2f} px")
    if len(lines) == 2:
        x0 = lines[0].x_at(middle)
        x1 = x0 + (lines[1].x_at(middle) - x0) / (1 + slope * slope)
        _arrow(upper, (x0, middle), (x1, middle - slope * (x1 - x0)), "<->")


def _arrow(axes: Any, start: tuple[float, float], end: tuple[float, float], style: str) -> None:
    axes.annotate("", end, start, arrowprops={"arrowstyle": style, "color": BLUE, "lw": 2})
