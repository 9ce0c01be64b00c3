"""`pamrig simulate`, `pamrig study`: the whole bench in simulation."""

from __future__ import annotations

import typer


def add_simulation(app: typer.Typer) -> None:
    """Add the commands that simulate to `app`."""
