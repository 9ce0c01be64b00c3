"""What the analysis of a test is made of: its reduction, its findings, its panels."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from analysis.reduction.points import Reduction
    from daq.live.layout import LiveLayout
    from daq.store.run import Run


@dataclass(frozen=True)
class Section:
    """A part of a report: a heading, words, a table, a figure; what is empty is left out.

    Attributes:
        title: heading.
        words: paragraphs of plain text.
        table: rows to print; columns are printed as ``columns`` heads them, and a column X
            with a column u_X beside it is printed as X ± 2 u_X.
        columns: (column, heading) pairs; a heading's unit stands after a comma.
        figure: drawn only when a page is written.
        caption: what the figure shows, and what its bars are.
    """

    title: str
    words: tuple[str, ...] = ()
    table: pd.DataFrame | None = None
    columns: tuple[tuple[str, str], ...] = ()
    figure: Callable[[], Figure] | None = None
    caption: str = ""


@dataclass(frozen=True)
class Findings:
    """What a test found, for its report and for --json.

    Attributes:
        headline: the result in one sentence.
        sections: tables and figures in reading order.
        data: plain values for --json (tables as lists of rows).
    """

    headline: str
    sections: tuple[Section, ...] = ()
    data: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Analysis:
    """How the runs of one protocol are analysed; needs the record alone, no hardware.

    Attributes:
        name: the protocol, as records name it.
        title: name for a person ("Isobaric test").
        reduce: a run to its table of points.
        layout: panels of the live view and the view file, from ``parameters`` of run.json.
        findings: results from the table; None where the report is the isometric one's.
    """

    name: str
    title: str
    reduce: Callable[[Run], Reduction]
    layout: Callable[[Mapping[str, Any]], LiveLayout]
    findings: Callable[[Run, Reduction], Findings] | None = None
