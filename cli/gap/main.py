"""`pamrig gap ...`: each command imports what it needs when it runs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Optional

import typer

from cli.gap.check import add_check

gap_app = typer.Typer(
    help="Where simulation and bench part, which effect causes it, what to measure next.",
    no_args_is_help=True,
)
add_check(gap_app)

DataArgument = Annotated[Path, typer.Argument(help="Folder in the dataset format.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON value, nothing else.")]
WithoutOption = Annotated[
    str, typer.Option("--without", help="Effects to strike from the catalogue, by commas.")
]
OutOption = Annotated[Optional[Path], typer.Option("--out", help="File to write.")]  # noqa: UP045


@gap_app.callback()
def gap() -> None:
    """Where simulation and bench part, which effect causes it, what to measure next."""


@gap_app.command("where")
def gap_where(
    data: DataArgument,
    out: Annotated[
        Optional[Path],  # noqa: UP045
        typer.Option("--out", help="Picture of the residual to write (.png, .svg, .pdf)."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Fitness of the data, the gap by stage, and which comparisons show it."""
    from cli.gap.commands import where_command

    where_command(data, out, as_json)


@gap_app.command("diagnose")
def gap_diagnose(
    data: DataArgument, without: WithoutOption = "", as_json: JsonOption = False
) -> None:
    """Name the effect behind the gap, or say why it cannot be named."""
    from cli.gap.commands import diagnose_command

    diagnose_command(data, without, as_json)


@gap_app.command("shrink")
def gap_shrink(
    data: DataArgument,
    without: WithoutOption = "",
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """How far the gap shrinks once the named effect is in; writes the improved plant."""
    from cli.gap.commands import shrink_command

    shrink_command(data, without, out, as_json)


@gap_app.command("next")
def gap_next(
    data: DataArgument,
    without: WithoutOption = "",
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """The experiment or reference standard that would settle what is open."""
    from cli.gap.commands import next_command

    next_command(data, without, out, as_json)
