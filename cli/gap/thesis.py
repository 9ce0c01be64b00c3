"""`pamrig gap thesis`: the measured tables of the thesis, diagnosed."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from gap.thesis.static_ladder import Step
    from gap.thesis.tables import TableVerdict


def gap_thesis(
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON value, nothing else.")
    ] = False,
) -> None:
    """Diagnose the thesis's tables: a ladder from its isometric table, verdicts on the others."""
    from gap.thesis.tables import diagnose_thesis

    verdicts = diagnose_thesis()
    if as_json:
        typer.echo(json.dumps([v.as_dict() for v in verdicts], indent=2, allow_nan=False))
        return
    for verdict in verdicts:
        typer.echo("\n".join(_lines(verdict)))


def _lines(verdict: TableVerdict) -> list[str]:
    lines = [
        f"{verdict.name}: {verdict.points} points, {verdict.settings} settings",
        f"  {verdict.status.replace('_', ' ')}: {verdict.reason}",
    ]
    if verdict.published is not None:
        sd, rms = verdict.published
        lines.append(f"  thesis's own geometry      {rms:6.2f} N rms (standard deviation {sd:.2f})")
    lines += [f"  {_step(step, first)}" for first, step in _numbered(verdict.steps)]
    if verdict.floor_n is not None:
        lines.append(f"  floor ({verdict.floor}) {verdict.floor_n:.2f} N")
    for label, rms in verdict.transfer.items():
        lines.append(f"  fitted to C-1 alone, {label}: {rms:.2f} N")
    return [*lines, ""]


def _numbered(steps: tuple[Step, ...]) -> list[tuple[bool, Step]]:
    return [(k == 0, step) for k, step in enumerate(steps)]


def _step(step: Step, first: bool) -> str:
    if first:
        return f"{'deterministic model':26} {step.rms:6.2f} N left out"
    name = max(step.added, key=lambda key: step.added[key])
    chance = "" if step.p is None else f", p {step.p:.2g}"
    text = f"{'+ ' + name:26} {step.rms:6.2f} N left out{chance}"
    if not step.kept:
        return text + ": not kept"
    if name in step.spread:
        low, high = step.spread[name]
        headline = next(iter(step.values[name]))
        text += f"; {headline} {step.values[name][headline]:.3g} ({low:.3g} to {high:.3g})"
    return text
