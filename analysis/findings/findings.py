"""The analysis of a protocol: its reduction, its findings and its live layout."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pathlib import Path

    import pandas as pd
    from matplotlib.figure import Figure

    from analysis.reduction.points import Reduction
    from daq.live.layout import LiveLayout
    from daq.store.run import Run

EXPANDED = "± expanded uncertainty, k = 2"
BARS = "Bars: expanded uncertainty, k = 2, if larger than the marker."
NO_SETTLED_POINT = "No settled point was reached, so there is no result."
NO_POINT = "No point was measured, so there is no result."


@dataclass(frozen=True)
class Section:
    """A section of a report. Empty parts are left out.

    Attributes:
        title: heading.
        words: paragraphs of plain text.
        table: rows to print. A column X with a column u_X is printed as X ± 2 u_X.
        columns: (column, heading) pairs of the printed columns; the unit in a heading follows a
            comma.
        figure: function that draws the figure; it is called only when a page is written.
        caption: describes the figure or the table, and the error bars.
    """

    title: str
    words: tuple[str, ...] = ()
    table: pd.DataFrame | None = None
    columns: tuple[tuple[str, str], ...] = ()
    figure: Callable[[], Figure | None] | None = None
    caption: str = ""


@dataclass(frozen=True)
class Findings:
    """Results of a test, for its report and for --json.

    Attributes:
        headline: the result in one sentence.
        sections: tables and figures in reading order.
        data: plain values for --json (tables as lists of rows).
        page_one: tables for page one, of a test without results that are means of repeats.
        report_entries: if given, these are entries of the JSON report in place of ``data`` and
            the sections.
    """

    headline: str
    sections: tuple[Section, ...] = ()
    data: dict[str, Any] = field(default_factory=dict)
    report_entries: dict[str, Any] | None = None
    page_one: tuple[Section, ...] = ()


POINT_SETTINGS = (
    "set_temperature_c", "set_length_mm", "mass_kg", "cycle_max_kpa", "set_pressure_kpa",
    "direction",
)  # fmt: skip
VALVE_SETTINGS = ("valve", "set_pressure_kpa")
"""Columns of a valve test that say which points are repeats of each other."""


@dataclass(frozen=True)
class ResultColumns:
    """Which columns of a table are results, and which say what is a repeat of what.

    Attributes:
        quantities: columns of results; page one of the report and acceptance limits are on these.
        settings: columns that are equal for repeats of one test; those that the table does not
            have, or that are empty in it, are left out.
        only: quantity to (column, word): a result only where that column holds the word; without
            a word, only where that column is empty.
        settled: only points that settled.
    """

    quantities: tuple[str, ...] = ("force_n",)
    settings: tuple[str, ...] = POINT_SETTINGS
    only: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    settled: bool = True


@dataclass(frozen=True)
class Analysis:
    """The analysis of the runs of one protocol. It needs the record only, no hardware.

    Attributes:
        name: the protocol, as in records.
        title: its title ("Isobaric test").
        reduce: reduces a run to its table of points.
        layout: panels of the live view and the view file, from ``parameters`` of run.json.
        findings: results from the table.
        results: columns of the table that are results, and those that repeats have in common.
        files: makes further derived files of a run in a folder; None for none.
    """

    name: str
    title: str
    reduce: Callable[[Run], Reduction]
    layout: Callable[[Mapping[str, Any]], LiveLayout]
    findings: Callable[[Run, Reduction], Findings]
    results: ResultColumns = ResultColumns()
    files: Callable[[Run, Path], None] | None = None


def source_table(run: Run) -> str | None:
    """The thesis table that a run was imported from ("C-1"), None for other runs."""
    table: str | None = (run.manifest.get("source") or {}).get("table")
    return table


def as_in(run: Run, place: str) -> str:
    """The place in the thesis, in brackets, for an import of its tables; "" for other runs."""
    return f" (as in {place} of the thesis)" if source_table(run) else ""


def max_pressure_kpa(parameters: Mapping[str, Any], key: str = "pressures_kpa") -> float:
    """The highest pressure of a test, for the axes of its live view."""
    return float(max(parameters.get(key) or [600.0]))


def claims_section(
    title: str, words: str, claims: Iterable[tuple[str, str, bool]], measured: str = "measured"
) -> Section:
    """A section that compares statements of the thesis with the results.

    Args:
        title: heading.
        words: one paragraph.
        claims: statement, result, and whether they agree.
        measured: heading of the results.
    """
    import pandas as pd

    return Section(
        title,
        (words,),
        pd.DataFrame(claims, columns=["claim", "found", "same"]),
        (("claim", "statement"), ("found", measured), ("same", "agrees")),
    )


def records(table: pd.DataFrame) -> list[dict[str, Any]]:
    """The rows of a table as dicts."""
    return [{str(k): v for k, v in row.items()} for row in table.to_dict("records")]
