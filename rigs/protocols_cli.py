"""One command for each test protocol; each imports what it needs when it runs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Optional

import typer

RigOption = Annotated[str, typer.Option("--rig", help="Rig file, or the name of a shipped one.")]
OutOption = Annotated[Path, typer.Option("--out", help="Folder of runs.")]
RUNS = Path("runs")
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON value, nothing else.")]


def isometric(
    rig: RigOption = "virtual",
    protocol: Annotated[
        str, typer.Option("--protocol", help="Protocol file, or the name of a shipped one.")
    ] = "isometric",
    out: OutOption = RUNS,
    specimen: Annotated[str, typer.Option(help="What is tested.")] = "muscle",
    operator: Annotated[str, typer.Option(help="Who tests.")] = "",
    note: Annotated[str, typer.Option(help="Anything worth remembering.")] = "",
    seed: Annotated[Optional[int], typer.Option(help="Seed of a virtual bench.")] = None,  # noqa: UP045
    live: Annotated[bool, typer.Option("--live", help="Show the test in the live view.")] = False,
    browser: Annotated[
        bool, typer.Option("--browser/--no-browser", help="Open the live view in the browser.")
    ] = True,
    wire: Annotated[bool, typer.Option("--wire", help="Record every received byte, too.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Run an isometric test: length held, pressure stepped, force read."""
    from rigs.commands import isometric_command

    raise typer.Exit(
        isometric_command(
            rig, protocol, out, specimen, operator, note, seed, live, browser, wire, as_json
        )
    )


def add_protocols(app: typer.Typer, runs_app: typer.Typer) -> None:
    """Add the commands that run tests to `app`, and those on recorded runs to `runs_app`."""
    app.command()(isometric)
