"""`pamrig gap ...`: each command imports what it needs when it runs."""

from __future__ import annotations

import typer

gap_app = typer.Typer(
    help="Where simulation and bench part, which effect causes it, what to measure next.",
    no_args_is_help=True,
)


@gap_app.callback()
def gap() -> None:
    """Where simulation and bench part, which effect causes it, what to measure next."""
