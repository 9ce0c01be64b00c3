"""What the commands of `pamrig gap` do: read, ask, print."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import typer

from gap.dataset import DataSet
from gap.diagnose import diagnose
from gap.opening import open_data as read_dataset
from gap.verdict import Verdict


def struck(text: str) -> list[str]:
    """Ids in a comma-separated list."""
    return [word.strip() for word in text.split(",") if word.strip()]


def show(value: Any) -> None:
    """Print one JSON value and nothing else."""
    typer.echo(json.dumps(value, indent=2, allow_nan=False))


def diagnose_command(data: Path, without: str, as_json: bool) -> None:
    """`pamrig gap diagnose`."""
    verdict = diagnose(read_dataset(data), struck(without))
    if as_json:
        show(verdict.as_dict())
    else:
        typer.echo("\n".join(as_text(verdict)))


def where_command(data: Path, as_json: bool) -> None:
    """`pamrig gap where`."""
    verdict = diagnose(read_dataset(data))
    table = verdict.as_dict()
    if as_json:
        show({"where": table["where"], "gap": table["gap"], "status": table["status"]})
    else:
        typer.echo("\n".join(_where_text(verdict)))


def shrink_command(data: Path, without: str, out: Path | None, as_json: bool) -> None:
    """`pamrig gap shrink`."""
    verdict = diagnose(read_dataset(data), struck(without))
    table = verdict.as_dict()
    if as_json:
        show({"gap": table["gap"], "status": table["status"], "effects": table["effects"]})
    else:
        typer.echo("\n".join(_gap_text(verdict)))


def next_command(data: Path, without: str, out: Path | None, as_json: bool) -> None:
    """`pamrig gap next`."""
    verdict = diagnose(read_dataset(data), struck(without))
    table = verdict.as_dict()
    if as_json:
        show({"next_experiment": table["next_experiment"], "status": table["status"]})
    else:
        typer.echo(str(table["next_experiment"]))


def as_text(verdict: Verdict) -> list[str]:
    """A verdict for people."""
    lines = [f"{verdict.status.replace('_', ' ')}: {verdict.reason}"]
    if verdict.stage:
        lines.append(f"stage       {verdict.stage}")
    for effect in verdict.effects:
        values = ", ".join(_estimate(name, e) for name, e in effect.parameters.items())
        lines.append(f"  {100 * effect.probability:3.0f} %  {' + '.join(effect.ids)}  {values}")
    lines.append(f"  {100 * verdict.probability_none:3.0f} %  no gap")
    lines.append(f"  {100 * verdict.probability_unknown:3.0f} %  something else")
    return [*lines, *_gap_text(verdict), *_where_text(verdict), *_notes(verdict.notes)]


def _estimate(name: str, estimate: Any) -> str:
    if isinstance(estimate.value, str):
        return f"{name} {estimate.value}"
    if estimate.low is None:
        return f"{name} {estimate.value:.4g}"
    return f"{name} {estimate.value:.4g} ({estimate.low:.4g} to {estimate.high:.4g})"


def _gap_text(verdict: Verdict) -> list[str]:
    gap = verdict.gap
    if gap is None:
        return []
    lines = [
        f"gap         untouched {gap.before:.3g}, recalibrated {gap.recalibrated:.3g}"
        + (f", after {gap.after:.3g}" if gap.after is not None else "")
        + (f", floor {gap.floor:.3g}" if gap.floor is not None else "")
        + f" {gap.unit} (held out by {gap.held_out})"
    ]
    if gap.closed is not None and gap.closed_low is not None and gap.closed_high is not None:
        lines.append(
            f"closed      {100 * gap.closed:.0f} % "
            f"({100 * gap.closed_low:.0f} to {100 * gap.closed_high:.0f})"
        )
    return lines


def _where_text(verdict: Verdict) -> list[str]:
    lines = [
        f"share       {s.stage} {100 * s.share:.0f} % ({100 * s.low:.0f} to {100 * s.high:.0f})"
        for s in verdict.stages
    ]
    loud = [c for c in verdict.contrasts if c.alarm]
    return lines + [f"contrast    {c.name} z = {c.z:.1f}" for c in loud]


def _notes(notes: Iterable[str]) -> list[str]:
    return [f"note        {note}" for note in notes]


def load(data: Path) -> DataSet:
    """Read the data set of a command."""
    return read_dataset(data)
