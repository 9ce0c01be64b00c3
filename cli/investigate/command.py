"""`pamrig gap investigate`: tests and diagnosis in turn, until the gap is named."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Optional

import typer


def gap_investigate(
    rig: Annotated[
        str, typer.Option("--rig", help="Rig file, or the name of a shipped one.")
    ] = "virtual",
    out: Annotated[Path, typer.Option("--out", help="Folder of runs.")] = Path("runs"),
    budget: Annotated[float, typer.Option("--budget", help="Bench time, minutes.")] = 60.0,
    plant: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option("--plant", help="Constants of the bench, as bench.toml holds them."),
    ] = None,
    seed: Annotated[Optional[int], typer.Option(help="Seed of a virtual bench.")] = None,  # noqa: UP045
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON value, nothing else.")
    ] = False,
) -> None:
    """Run tests on a rig and diagnose them, until the gap is named or the budget is used up."""
    from cli.investigate.investigate import investigate
    from daq.interrupt import stop_on_signals
    from rigs.rigfile.config import load_rig

    def report(text: str) -> None:
        typer.echo(text, err=as_json)

    with stop_on_signals() as stop:
        found = investigate(
            load_rig(rig, seed), out, budget_min=budget, plant=plant, stop=stop, report=report
        )
    if as_json:
        typer.echo(json.dumps(found.as_dict(), indent=2, allow_nan=False))
    else:
        typer.echo(f"{found.conclusion}: {found.why}")
        for name, how in found.references.items():
            typer.echo(f"  {name}: {how}")
        typer.echo(f"rounds   {found.folder / 'investigation.json'}")
    if found.ended is not None:
        typer.echo(f"ended by a fault, concluded from the tests before it: {found.ended}", err=True)
        raise typer.Exit(2)
