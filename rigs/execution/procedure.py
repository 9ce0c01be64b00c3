"""What a test protocol is to everything that runs, shows, reduces and reports tests."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

from rigs.execution.steps import Steps

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from analysis.reduction.points import Reduction
    from daq.live.layout import LiveLayout
    from daq.store.run import Run
    from rigs.rigfile.config import RigConfig


class Plan(Protocol):
    """The parameters of one test, as read from its protocol file."""

    @property
    def name(self) -> str:
        """Name of the test, as its file says."""
        ...

    @property
    def frames(self) -> int:
        """Pictures at a point; 0 for a test without the camera."""
        ...

    def as_dict(self) -> dict[str, Any]:
        """Plain values for run.json."""
        ...

    def steps(self) -> Steps:
        """The method, top to bottom; a new generator each time."""
        ...


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
class Procedure:
    """One kind of test.

    Attributes:
        name: its command, and ``protocol`` in its files and records.
        title: name for a person ("Isobaric test").
        read: protocol file (path or shipped name) and rig to checked parameters; refuses,
            with file and key, what the rig cannot do.
        reduce: a run to its table of points.
        findings: what its table says; None where the report is the isometric one's.
        layout: the screen, from the ``parameters`` of run.json.
        firmware: settings of the controller that this test needs, over those of the rig.
    """

    name: str
    title: str
    read: Callable[[str, RigConfig], Plan]
    reduce: Callable[[Run], Reduction]
    layout: Callable[[Mapping[str, Any]], LiveLayout]
    findings: Callable[[Run, Reduction], Findings] | None = None
    firmware: Mapping[str, int] = field(default_factory=dict)
