"""What is made of a run for people: a headline, sections of tables and figures, results.

Each protocol has a module ``rigs.analysis_<protocol>`` (hyphens become underscores) with one
function ``analyse(run, reduction=None) -> Analysis``; the report renders whatever it gives.
"""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from daq.errors import RecordError
from rigs.reduction import Reduction

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from daq.run import Run


@dataclass(frozen=True)
class Column:
    r"""One column of a table in a report.

    Attributes:
        key: of the row.
        heading: with its unit behind a line feed: ``"force\nN"``.
        u: key of the standard uncertainty; printed expanded, k = 2, behind the value.
        decimals: fixed, where there is no uncertainty; None for as many as the value has.
        text: set to the left.
    """

    key: str
    heading: str
    u: str = ""
    decimals: int | None = None
    text: bool = False


@dataclass(frozen=True)
class Section:
    """One part of a report: words, then a table, then a figure; each may be missing.

    Attributes:
        title: its heading.
        text: paragraphs.
        columns, rows: the table; a row is a mapping with the columns' keys.
        off: key of a row that is true where the row is to be shaded (does not agree, not settled).
        caption: below the table.
        figure: makes the figure when the report is written; None without one.
        figure_caption, alt: below the figure, and for those who cannot see it.
        detail: a small part of the section before.
    """

    title: str
    text: tuple[str, ...] = ()
    columns: tuple[Column, ...] = ()
    rows: tuple[dict[str, Any], ...] = ()
    off: str = ""
    caption: str = ""
    figure: Callable[[], Figure] | None = None
    figure_caption: str = ""
    alt: str = ""
    detail: bool = False


@dataclass(frozen=True)
class Analysis:
    """Everything a report says about one run beyond how it went.

    Attributes:
        reduction: the table of the run, its notes and the calibrations applied.
        headline: the result in one sentence.
        results: plain values by name, for ``--json``; uncertainties as ``u_<name>``.
        sections: in the order of the report.
        tables: further tables, by file name without suffix, written beside table.csv.
    """

    reduction: Reduction
    headline: str
    results: dict[str, Any] = field(default_factory=dict)
    sections: tuple[Section, ...] = ()
    tables: dict[str, pd.DataFrame] = field(default_factory=dict)


def rows_of(table: pd.DataFrame) -> tuple[dict[str, Any], ...]:
    """The rows of a table as a section wants them."""
    return tuple({str(k): v for k, v in row.items()} for row in table.to_dict("records"))


def analyse(run: Run, reduction: Reduction | None = None) -> Analysis | None:
    """The analysis of a run by its protocol; None where the protocol has none of its own.

    Raises:
        RecordError: run.json is damaged.
    """
    module = _module(str(run.manifest.get("protocol", "")))
    if module is None:
        return None
    found = importlib.import_module(module).analyse(run, reduction)
    if not isinstance(found, Analysis):
        raise RecordError(str(run.folder), f"{module} made no analysis")
    return found


def _module(protocol: str) -> str | None:
    name = f"rigs.analysis_{protocol.replace('-', '_')}"
    if not protocol.replace("-", "").isalpha() or importlib.util.find_spec(name) is None:
        return None
    return name


def write_tables(analysis: Analysis, folder: Any) -> None:
    """Write the further tables as CSV: the same bytes for the same tables."""
    for name, table in analysis.tables.items():
        table.to_csv(folder / f"{name}.csv", index=False, lineterminator="\n")


def agreeing(rows: Iterable[dict[str, Any]], key: str = "same") -> int:
    """How many rows of a comparison agree."""
    return sum(bool(row[key]) for row in rows)
