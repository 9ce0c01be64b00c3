"""`pamrig gap investigate`."""

from __future__ import annotations

from typing import Annotated

import typer

from cli.options import RUNS, JsonOption, OutOption, PlantOption, RigOption, SeedOption
from cli.output import print_json


def investigate(
    rig: RigOption = "virtual",
    out: OutOption = RUNS,
    budget: Annotated[float, typer.Option("--budget", help="Bench time, minutes.")] = 60.0,
    plant: PlantOption = None,
    seed: SeedOption = None,
    as_json: JsonOption = False,
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
        print_json(found.as_dict())
    else:
        typer.echo(f"{found.conclusion}: {found.why}")
        for name, how in found.references.items():
            typer.echo(f"  {name}: {how}")
        typer.echo(f"rounds   {found.folder / 'investigation.json'}")
    if found.ended is not None:
        typer.echo(
            f"ended by a fault; the conclusion is from the tests before it: {found.ended}", err=True
        )
        raise typer.Exit(2)
