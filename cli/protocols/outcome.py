"""What a test came to, printed; its exit status."""

from __future__ import annotations

from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from rigs.execution.session import Result


def exit_status(result: Result) -> int:
    """0 for a clean run, 130 for one that was stopped, 2 for a fault."""
    return {"clean": 0, "stopped": 130}.get(result.outcome, 2)


def print_result(result: Result, not_derived: str) -> int:
    """Print outcome, reason and where report and table are; returns the exit status.

    Args:
        result: how the test ended.
        not_derived: why table and report could not be made, or "".
    """
    status = exit_status(result)
    typer.echo(f"{result.outcome}: {result.points} of {result.planned} points in {result.folder}")
    if result.error:
        typer.echo(f"  because: {result.error}")
    if not_derived:
        typer.echo(f"  table and report could not be made: {not_derived}")
        typer.echo(f"  the record is safe; later: pamrig runs rebuild {result.folder}")
        return status or 2
    typer.echo(f"  report: {result.folder / 'derived' / 'report.html'}")
    typer.echo(f"  table:  {result.folder / 'derived' / 'table.csv'}")
    return status
