"""Figure of the residual's courses over pressure, length, temperature and time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from daq.wholefile import whole_files
from gap.errors import GapError
from gap.output import check_out
from gap.validation.maps import AXES, Course

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BLUE, GREEN, QUIET = "#0072B2", "#009E73", "#8a8a8a"  # Okabe and Ito


def courses_figure(courses: Sequence[Course], named: bool) -> Figure | None:
    """One row a block, one column an axis; the band is the floor. None without any course."""
    from matplotlib import pyplot

    blocks = list(dict.fromkeys(course.block for course in courses))
    overs = [over for over in AXES if any(course.over == over for course in courses)]
    if not blocks:
        return None
    made = pyplot.subplots(
        len(blocks), len(overs), figsize=(0.6 + 2.3 * len(overs), 0.5 + 1.75 * len(blocks)),
        squeeze=False, layout="constrained", sharey="row",
    )  # fmt: skip
    figure: Figure = made[0]
    axes: Any = made[1]
    pyplot.close(figure)
    for i, block in enumerate(blocks):
        for j, over in enumerate(overs):
            axis = axes[i][j]
            found = [c for c in courses if c.block == block and c.over == over]
            if not found:
                axis.set_visible(False)
                continue
            _draw(axis, found[0], named)
            if i == len(blocks) - 1 or not any(
                c.over == over and c.block in blocks[i + 1 :] for c in courses
            ):
                axis.set_xlabel(f"{over}, {AXES[over]}")
        first = next(c for c in courses if c.block == block)
        axes[i][0].set_ylabel(f"{block}, {first.unit}")
    handles = {
        label: handle
        for axis in axes.flat
        for handle, label in zip(*axis.get_legend_handles_labels(), strict=True)
    }
    figure.legend(
        handles.values(), handles.keys(), loc="outside upper center", ncols=3, fontsize=8,
        frameon=False,
    )  # fmt: skip
    return figure


def _draw(axis: Any, course: Course, named: bool) -> None:
    axis.axhspan(-course.floor, course.floor, color=QUIET, alpha=0.18, lw=0, label="floor (rms)")
    axis.axhline(0.0, color=QUIET, lw=0.7)
    shift = 0.006 * float(np.ptp(course.centre)) if named else 0.0
    axis.errorbar(
        course.centre - shift, course.before, yerr=np.nan_to_num(1.96 * course.error), fmt="o-",
        ms=3, lw=1.0, color=BLUE, label="recalibrated",
    )  # fmt: skip
    if named:
        axis.errorbar(
            course.centre + shift, course.after, yerr=np.nan_to_num(1.96 * course.error_after),
            fmt="s-", ms=3, lw=1.0, color=GREEN, label="with what was found",
        )  # fmt: skip
    axis.tick_params(labelsize=8)


def check_picture(path: Path | None) -> None:
    """Raise `GapError` where no picture could be written: checked before the work, not after it."""
    from matplotlib.backend_bases import FigureCanvasBase

    check_out(path)
    known = FigureCanvasBase.get_supported_filetypes()
    if path is not None and path.suffix[1:].lower() not in known:
        raise GapError(str(path), "has no picture's ending", "end it in .png, .svg or .pdf")


def write_courses(courses: Sequence[Course], named: bool, path: Path) -> None:
    """Write the figure to a file; its suffix gives the format.

    Raises:
        GapError: nothing to draw, an ending that is no picture's, or a file that cannot be written.
    """
    figure = courses_figure(courses, named)
    if figure is None:
        raise GapError(str(path), "there is no residual to draw")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_files() as part:
            figure.savefig(part(path), dpi=150, format=path.suffix.lstrip(".").lower())
    except (OSError, ValueError) as error:
        raise GapError(str(path), f"cannot be written: {error}") from None
