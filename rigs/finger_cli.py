"""`pamrig study finger` and `pamrig study controllers`: thin, the work is in `rigs.controllers`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Optional

import typer

JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON value, nothing else.")]
FigureOption = Annotated[
    Optional[Path],  # noqa: UP045
    typer.Option("--figures", help="Folder to write figures to."),
]
LawsOption = Annotated[str, typer.Option("--laws", help="Controllers, by commas.")]


def add_finger_studies(study_app: typer.Typer) -> None:
    """Add the studies of the finger to `pamrig study`."""
    study_app.command("finger")(finger)
    study_app.command("controllers")(controllers)
    study_app.command("pressure")(pressure)


def finger(
    finger: Annotated[str, typer.Option("--finger", help="Finger file, or a shipped one.")] = (
        "finger"
    ),
    laws: LawsOption = "feedforward,adaptive",
    valve: Annotated[str, typer.Option("--valve", help="Valve file, or a shipped one.")] = "cured",
    as_json: JsonOption = False,
) -> None:
    """Does a controller hold a joint and follow the fingertip's circle, with and without 20 g?"""
    from rigs.finger_commands import finger_command

    finger_command(finger, laws, valve, as_json)


def pressure(as_json: JsonOption = False) -> None:
    """Controllers of one muscle's pressure on both valves, side by side."""
    from rigs.finger_commands import pressure_command

    pressure_command(as_json)


def controllers(
    finger: Annotated[str, typer.Option("--finger", help="Finger file, or a shipped one.")] = (
        "finger"
    ),
    laws: LawsOption = "all",
    perturbed: Annotated[
        bool, typer.Option("--perturbed", help="Host laws on plants they were not told of.")
    ] = False,
    figures: FigureOption = None,
    as_json: JsonOption = False,
) -> None:
    """All controllers on both valves, with and without payload; takes some minutes."""
    from rigs.finger_commands import controllers_command

    controllers_command(finger, laws, perturbed, figures, as_json)
