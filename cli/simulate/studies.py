"""Studies of valve and control schemes: `pamrig study schemes`, `ram`, `orifice`, `delay`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Optional

import typer

STUDIES = {
    "schemes": "What section 5.8 reports of the four schemes, statement by statement.",
    "ram": "What section 5.9 reports of the pneumatic ram, and why it was held.",
    "orifice": "How small an orifice and how fast a valve would have cured the oscillation.",
    "delay": "Inertial against transport delay: does it matter, and how to tell.",
}


def add_valve_studies(study_app: typer.Typer) -> None:
    """Add these studies to the commands of `pamrig study`."""
    for name, summary in STUDIES.items():
        study_app.command(name)(_command(name, summary))


def _command(name: str, summary: str) -> Callable[..., None]:
    def command(
        full: Annotated[
            bool, typer.Option("--full", help="At the size of the docs; takes minutes.")
        ] = False,
        out: Annotated[
            Optional[Path],  # noqa: UP045
            typer.Option("--out", help="Folder for the figures; none are drawn without."),
        ] = None,
        as_json: Annotated[
            bool, typer.Option("--json", help="Print one JSON value, nothing else.")
        ] = False,
    ) -> None:
        from studies.schemes.command import study_command

        raise typer.Exit(study_command(name, full, out, as_json))

    command.__doc__ = summary
    return command
