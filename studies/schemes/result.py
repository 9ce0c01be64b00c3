"""What a study hands out: statements with verdicts, tables, figures."""

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
    """A sentence of the thesis, and what the simulation says to it.

    Attributes:
        said: the statement in short, `where` its section.
        verdict: `CONFIRMED`, `CONTRADICTED` or `PARTLY`.
        because: the figures that decide it, and the cause.
    """

    said: str
    where: str
    verdict: str
    because: str


@dataclass(frozen=True)
class Grid:
    """A table: heads with units, rows of text or numbers."""

    title: str
    heads: tuple[str, ...]
    rows: tuple[tuple[Any, ...], ...]

    def markdown(self) -> str:
        """As the docs print it."""
        lines = [f"**{self.title}**", "", _line(self.heads), _line(["---"] * len(self.heads))]
        return "\n".join([*lines, *(_line([_cell(v) for v in row]) for row in self.rows)])


@dataclass(frozen=True)
class Study:
    """A study's answers; `figures` are drawn only when somebody wants them."""

    name: str
    question: str
    statements: tuple[Statement, ...]
    grids: tuple[Grid, ...]
    figures: dict[str, Callable[[], Figure]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def markdown(self) -> str:
        """Everything but the figures."""
        parts = [f"# {self.question}"]
        rows = tuple((s.said, s.where, s.verdict, s.because) for s in self.statements)
        if rows:
            heads = ("statement", "section", "verdict", "figures and cause")
            parts.append(Grid("Statements", heads, rows).markdown())
        parts += [grid.markdown() for grid in self.grids]
        parts += list(self.notes)
        return "\n\n".join(parts)

    def as_json(self) -> dict[str, Any]:
        """Plain values, null for what is unknown."""
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
