"""`pamrig gap thesis`: the measured tables of the thesis, diagnosed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer

from cli.options import JsonOption
from cli.output import print_json

if TYPE_CHECKING:
    from gap.thesis.static_ladder import Step
    from gap.thesis.tables import TableVerdict


def thesis(as_json: JsonOption = False) -> None:
    """Diagnose the thesis's tables: nested models on the isometric one, verdicts on the others."""
    from gap.thesis.tables import diagnose_thesis

    verdicts = diagnose_thesis()
    if as_json:
        print_json([v.as_dict() for v in verdicts])
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
    lines += [f"  {_step(step, first=k == 0)}" for k, step in enumerate(verdict.steps)]
    if verdict.floor_n is not None:
        lines.append(f"  floor ({verdict.floor}) {verdict.floor_n:.2f} N")
    for label, rms in verdict.transfer.items():
        lines.append(f"  fitted to C-1 alone, {label}: {rms:.2f} N")
    return [*lines, ""]


def _step(step: Step, first: bool) -> str:
    if first:
        return f"{'deterministic model':26} {step.rms:6.2f} N held out"
    name = max(step.added, key=lambda key: step.added[key])
    chance = "" if step.p is None else f", p {step.p:.2g}"
    text = f"{'+ ' + name:26} {step.rms:6.2f} N held out{chance}"
    if not step.kept:
        return text + ": not kept"
    if name in step.spread:
        low, high = step.spread[name]
        headline = next(iter(step.values[name]))
        text += f"; {headline} {step.values[name][headline]:.3g} ({low:.3g} to {high:.3g})"
    return text
