"""Results of a study: statements with verdicts, tables, figures."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CONFIRMED = "confirmed"
CONTRADICTED = "contradicted"
PARTLY = "partly"


@dataclass(frozen=True)
class Statement:
    """A statement of the thesis, and the result of the simulation.

    Attributes:
        said: the statement in short form; `where` is its section.
        verdict: `CONFIRMED`, `CONTRADICTED` or `PARTLY`.
        because: the deciding figures, and the cause.
    """

    said: str
    where: str
    verdict: str
    because: str


@dataclass(frozen=True)
class Grid:
    """A table: headings with units, rows of text or numbers."""

    title: str
    heads: tuple[str, ...]
    rows: tuple[tuple[Any, ...], ...]

    def markdown(self) -> str:
        """The table as Markdown."""
        lines = [f"**{self.title}**", "", _line(self.heads), _line(["---"] * len(self.heads))]
        return "\n".join([*lines, *(_line([_cell(v) for v in row]) for row in self.rows)])


@dataclass(frozen=True)
class Study:
    """The results of a study; `figures` are functions that draw them."""

    name: str
    question: str
    statements: tuple[Statement, ...]
    grids: tuple[Grid, ...]
    figures: dict[str, Callable[[], Figure]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def markdown(self) -> str:
        """All results except the figures."""
        parts = [f"# {self.question}"]
        rows = tuple((s.said, s.where, s.verdict, s.because) for s in self.statements)
        if rows:
            heads = ("statement", "section", "verdict", "figures and cause")
            parts.append(Grid("Statements", heads, rows).markdown())
        parts += [grid.markdown() for grid in self.grids]
        parts += list(self.notes)
        return "\n\n".join(parts)

    def as_json(self) -> dict[str, Any]:
        """Plain values; unknown values are null."""
        return {
            "study": self.name,
            "question": self.question,
            "statements": [vars(s) for s in self.statements],
            "tables": [
                {"title": g.title, "heads": list(g.heads), "rows": [_plain(r) for r in g.rows]}
                for g in self.grids
            ],
            "notes": list(self.notes),
        }


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _cell(value: Any) -> str:
    if isinstance(value, float):
        return "–" if not math.isfinite(value) else f"{value:.3g}"
    return str(value)


def _plain(row: Sequence[Any]) -> list[Any]:
    return [None if isinstance(v, float) and not math.isfinite(v) else v for v in row]
