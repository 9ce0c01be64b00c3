"""`pamrig simulate`, `pamrig study`: the whole bench in simulation."""

from __future__ import annotations

import typer

from rigs.finger_cli import add_finger_studies


def add_simulation(app: typer.Typer) -> None:
    """Add the commands that simulate to `app`."""
    study_app = typer.Typer(help="Questions put to the simulation.", no_args_is_help=True)
    app.add_typer(study_app, name="study")
    add_finger_studies(study_app)
