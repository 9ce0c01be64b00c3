"""The `pamrig runs` commands."""

from __future__ import annotations

import json
from pathlib import Path

import typer

from daq.store.store import find_run, list_runs, show, verify


def list_command(runs: Path, as_json: bool) -> None:
    """All runs, oldest first."""
    found = list_runs(runs)
    if as_json:
        typer.echo(json.dumps([info.as_dict() for info in found], indent=2, allow_nan=False))
        return
    if not found:
        typer.echo(f"no runs in {runs}")
    for info in found:
        length = f"{info.duration_s:8.1f} s" if info.duration_s is not None else "         –"
        typer.echo(
            f"{info.outcome:12} {length}  {info.protocol:10} {info.specimen:14} {info.run_id}"
        )


def show_command(run: str, runs: Path, as_json: bool) -> None:
    """What one run is and how it ended."""
    facts = show(find_run(runs, run))
    if as_json:
        typer.echo(json.dumps(facts, indent=2, allow_nan=False))
        return
    typer.echo(
        f"{facts['run_id']}\n  {facts['protocol']} of {facts['specimen']}: {facts['outcome']}"
    )
    final = facts.get("final") or {}
    if final.get("reason"):
        typer.echo(f"  because: {final['reason']}")
    typer.echo(
        f"  started {facts['started_utc']}, {facts['bytes'] / 1e6:.1f} MB, {facts['frames']} frames"
    )
    for name, stream in facts["streams"].items():
        lost = f", {len(stream['lost_rows'])} damaged stretches" if stream["lost_rows"] else ""
        typer.echo(f"  stream {name}: {stream['rows']} rows{lost}")
    counters = (final.get("counters") or {}).get("valve") or {}
    if counters:
        typer.echo(
            "  telemetry: {missing} samples missing in {gaps} gaps, {damaged} damaged frames, "
            "{duplicates} duplicates".format_map(counters)
        )
    typer.echo(
        "  events: " + ", ".join(f"{n} {kind}" for kind, n in sorted(facts["events"].items()))
    )
    typer.echo("  derived: " + (", ".join(facts["derived"]) or "nothing (pamrig runs rebuild)"))
    for problem in facts["problems"]:
        typer.echo(f"  PROBLEM {problem}")


def verify_command(run: str, runs: Path, as_json: bool) -> int:
    """Check every byte; 0 when sound, 1 when something is damaged."""
    found = find_run(runs, run)
    problems = verify(found)
    if as_json:
        value = {
            "run_id": found.run_id,
            "outcome": found.outcome,
            "sound": not problems,
            "problems": [{"file": p.file, "offset": p.offset, "what": p.what} for p in problems],
        }
        typer.echo(json.dumps(value, indent=2, allow_nan=False))
    elif not problems:
        typer.echo(f"{found.run_id}: sound ({found.outcome})")
    else:
        typer.echo(f"{found.run_id} ({found.outcome}):")
        for problem in problems:
            typer.echo(f"  {problem}")
    return 1 if problems else 0


def rebuild_command(run: str, runs: Path, as_json: bool) -> None:
    """Make everything derived anew."""
    from analysis.reporting.derived import derive_all

    made = derive_all(find_run(runs, run).folder)
    names = sorted(p.name for p in (made.folder / "derived").iterdir())
    if as_json:
        typer.echo(json.dumps({"run_id": made.run_id, "derived": names}, indent=2))
    else:
        typer.echo(f"{made.folder / 'derived'}: {', '.join(names)}")
