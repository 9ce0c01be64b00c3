"""The figures of a report as files for a paper: PDF and SVG in a column's width."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from analysis.figures.comparison import chart_figure, overlay_figure
from analysis.figures.drawing import as_pdf, as_svg, single_column
from analysis.figures.timeline import timeline_figure
from analysis.registry import analysis_of
from analysis.reporting.several import Comparison, chart_data, curves_of
from analysis.run_table import contents_of, reduce_run
from daq.wholefile import whole_files

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from daq.store.run import Run

Named = tuple[str, "Figure"]


def run_figures(run: Run, width: str = "double") -> list[Named]:
    """Title and figure of everything that the report of a run draws.

    Args:
        run: an opened run.
        width: "double" (180 mm) or "single" (88 mm).
    """
    if width == "single":
        with single_column():
            return run_figures(run)
    reduction = reduce_run(run)
    with contents_of(run):
        sections = analysis_of(run.manifest.get("protocol")).findings(run, reduction).sections
        made = [(s.title, s.figure()) for s in sections if s.figure is not None]
        if not run.manifest.get("imported"):
            made.append(("Time line of the run", timeline_figure(run)))
    return [(title, figure) for title, figure in made if figure is not None]


def comparison_figures(found: Comparison, width: str = "double") -> list[Named]:
    """Title and figure of everything that a report over several runs draws."""
    if width == "single":
        with single_column():
            return comparison_figures(found)
    charts = [
        (f"Control chart {one.name}", chart_figure(*chart_data(found, one)))
        for one in found.charted
    ]
    return [("Runs over each other", overlay_figure(curves_of(found))), *charts]


def write_figures(figures: Iterable[Named], folder: Path) -> list[Path]:
    """Write each figure as PDF (fonts embedded) and SVG (letters as text).

    Returns:
        the files, named by number and title.

    Raises:
        OSError: the folder cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    with whole_files() as part:
        for number, (title, figure) in enumerate(figures, start=1):
            name = f"{number:02d}-{re.sub(r'[^a-z0-9]+', '-', title.lower()).strip('-')[:60]}"
            for ending, content in (("pdf", as_pdf(figure)), ("svg", as_svg(figure, text=True))):
                paths.append(folder / f"{name}.{ending}")
                part(paths[-1]).write_bytes(content)
    return paths
