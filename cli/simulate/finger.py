"""`pamrig study finger`, `controllers`, `pressure`, `tuning`: thin, the work is elsewhere."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Optional

import typer

JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON value, nothing else.")]
PageOption = Annotated[bool, typer.Option("--page", help="Print the table as Markdown.")]
SeedsOption = Annotated[
    int, typer.Option("--seeds", min=1, max=1000, help="Draws of the noise, seeds 1, 2, ...")
]
FingerOption = Annotated[str, typer.Option("--finger", help="Finger file, or a shipped one.")]
ValveOption = Annotated[str, typer.Option("--valve", help="Valve file, or a shipped one.")]
LawsOption = Annotated[str, typer.Option("--laws", help="Controllers, by commas.")]


def add_finger_studies(study_app: typer.Typer) -> None:
    """Add the studies of the finger to `pamrig study`."""
    study_app.command("finger")(finger)
    study_app.command("controllers")(controllers)
    study_app.command("pressure")(pressure)
    study_app.command("tuning")(tuning)


def finger(
    finger: FingerOption = "finger",
    laws: LawsOption = "feedforward,adaptive",
    valve: ValveOption = "cured",
    seeds: SeedsOption = 1,
    page: PageOption = False,
    as_json: JsonOption = False,
) -> None:
    """Does a controller hold a joint and follow the fingertip's circle, with and without 20 g?"""
    from cli.simulate.finger_commands import finger_command

    raise typer.Exit(finger_command(finger, laws, valve, seeds, page, as_json))


def pressure(seeds: SeedsOption = 5, page: PageOption = False, as_json: JsonOption = False) -> None:
    """Controllers of one muscle's pressure on both valves, side by side."""
    from cli.simulate.finger_commands import pressure_command

    raise typer.Exit(pressure_command(seeds, page, as_json))


def tuning(
    finger: FingerOption = "finger",
    valve: ValveOption = "cured",
    as_json: JsonOption = False,
) -> None:
    """Where the gains come from, and what loops tuned one at a time do; takes a minute."""
    from cli.simulate.finger_commands import tuning_command

    tuning_command(finger, valve, as_json)


def controllers(
    finger: FingerOption = "finger",
    laws: LawsOption = "all",
    perturbed: Annotated[
        bool, typer.Option("--perturbed", help="Host laws on plants they were not told of.")
    ] = False,
    seeds: SeedsOption = 5,
    figures: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option("--figures", help="Folder to write figures to."),
    ] = None,
    page: PageOption = False,
    as_json: JsonOption = False,
) -> None:
    """All controllers on both valves, with and without payload; takes some minutes."""
    from cli.simulate.finger_commands import controllers_command

    raise typer.Exit(controllers_command(finger, laws, perturbed, seeds, figures, page, as_json))
