"""Terminal output of the commands that run tests: progress line, result, exit status."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING, Any

import typer

if TYPE_CHECKING:
    from pathlib import Path

    from rigs.execution.runner import Runner, Watch
    from rigs.execution.session import Result

REDRAW_S = 0.1


class ProgressLine:
    """One line on the terminal: state, points done, time left. `quiet` prints nothing."""

    def __init__(self, quiet: bool) -> None:
        self._quiet = quiet
        self._tty = sys.stderr.isatty()
        self._runner: Runner | None = None
        self._start = 0.0
        self._last = 0.0
        self._width = 0

    def watch(self) -> Watch:
        """Callbacks for the runner."""
        from rigs.execution.runner import Watch

        return Watch(
            state=self.state, point=lambda *_: self.redraw(), log=lambda t: typer.echo(t, err=True)
        )

    def start(self, runner: Runner, record: Any) -> None:
        """The run begins."""
        self._runner = runner
        self._start = time.monotonic()
        if not self._quiet:
            from rigs.devices.operator import at_a_terminal
            from rigs.execution.control import KEYS

            typer.echo(f"recording to {record.folder}", err=True)
            if at_a_terminal():
                typer.echo(f"keys, then Enter: {KEYS}", err=True)

    def state(self, text: str) -> None:
        """Show a new phase; without a terminal to redraw, print a line."""
        if not self._quiet and not self._tty:
            typer.echo(f"  {text}{self._left()}", err=True)
        self.redraw(text)

    def redraw(self, text: str = "") -> None:
        """Redraw the line, at most every `REDRAW_S` seconds."""
        now = time.monotonic()
        if self._quiet or not self._tty or self._runner is None or now - self._last < REDRAW_S:
            return
        self._last = now
        line = f"{text or self._runner.progress.state}{self._left()}"
        typer.echo("\r" + line.ljust(self._width), nl=False, err=True)
        self._width = len(line)

    def _left(self) -> str:
        if self._runner is None:
            return ""
        from rigs.steps.watching import time_left_s

        p = self._runner.progress
        text = f"  {p.done}/{p.points} points"
        left_s = time_left_s(
            p.seconds, p.spent_s, time.monotonic() - self._start, self._runner.rig.clock.virtual
        )
        if left_s is not None and p.done < p.points:
            text += f", about {left_s:.0f} s left"
        return text

    def close(self) -> None:
        """End the line."""
        if self._width:
            typer.echo("", err=True)


def exit_status(result: Result) -> int:
    """0 for a clean run, 130 for one that was stopped, 2 for a fault."""
    return {"clean": 0, "stopped": 130}.get(result.outcome, 2)


def print_outcome(result: Result) -> None:
    """Print how a test ended, its points, folder and error."""
    typer.echo(f"{result.outcome}: {result.points} of {result.planned} points in {result.folder}")
    if result.error:
        typer.echo(f"  because: {result.error}")


def record_sentence(folder: Path) -> str:
    """What a check of the record says, after table and report could not be made."""
    from daq.errors import RecordError
    from daq.store.run import open_run
    from daq.store.verify import verify

    try:
        problems = verify(open_run(folder))
    except RecordError as error:
        return f"the record cannot be read: {error}"
    if problems:
        return f"a check of the record found: {problems[0]} (pamrig runs verify lists all)"
    return f"the record was checked and is sound; later: pamrig runs rebuild {folder}"


def print_result(result: Result, not_derived: str) -> int:
    """Print the outcome and where report and table are; returns the exit status.

    Args:
        result: how the test ended.
        not_derived: why table and report could not be made, or "".
    """
    print_outcome(result)
    status = exit_status(result)
    if not_derived:
        typer.echo(f"  table and report could not be made: {not_derived}")
        typer.echo(f"  {record_sentence(result.folder)}")
        return status or 2
    typer.echo(f"  report: {result.folder / 'derived' / 'report.html'}")
    typer.echo(f"  table:  {result.folder / 'derived' / 'table.csv'}")
    return status
