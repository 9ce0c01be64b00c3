"""Terminal output of the commands that run tests: progress line, result, exit status."""

from __future__ import annotations

import math
import sys
import time
from typing import TYPE_CHECKING, Any

import typer

if TYPE_CHECKING:
    from pathlib import Path

    from rigs.execution.runner import Runner, Watch
    from rigs.execution.session import Result

REDRAW_S = 0.1
LINE_S = 10.0
"""Without a terminal, lines of progress are at least this far apart ..."""
LINE_SHARE = 0.05
"""... and by this share of the time since the start: a test of days does not fill a log file."""


class ProgressLine:
    """Progress of a test: state, points done, time left. `quiet` prints nothing.

    On a terminal it is one line that is drawn again and again. In a file, a pipe or a notebook it
    is a new line now and then, without carriage returns.
    """

    def __init__(self, quiet: bool) -> None:
        self._quiet = quiet
        self._tty = sys.stderr.isatty()
        self._runner: Runner | None = None
        self._start = 0.0
        self._last = -math.inf
        self._width = 0

    def watch(self) -> Watch:
        """Callbacks for the runner."""
        from rigs.execution.runner import Watch

        return Watch(state=self.redraw, point=lambda *_: self.redraw(), log=self.log)

    def start(self, runner: Runner, record: Any) -> None:
        """The run begins."""
        self._runner = runner
        self._start = time.monotonic()
        self._last = -math.inf
        if not self._quiet:
            from rigs.devices.operator import at_a_terminal
            from rigs.execution.control import KEYS

            typer.echo(f"recording to {record.folder}", err=True)
            if at_a_terminal():
                typer.echo(f"keys, then Enter: {KEYS}", err=True)

    def log(self, text: str) -> None:
        """Print a message on a line of its own."""
        self.close()
        typer.echo(text, err=True)

    def redraw(self, text: str = "") -> None:
        """Show a new state, or the same one again, unless that was done a moment ago."""
        now = time.monotonic()
        apart_s = REDRAW_S if self._tty else max(LINE_S, LINE_SHARE * (now - self._start))
        if self._quiet or self._runner is None or now - self._last < apart_s:
            return
        self._last = now
        line = f"{text or self._runner.progress.state}{self._left()}"
        if not self._tty:
            typer.echo(f"  {line}", err=True)
            return
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
        """End the line that is being drawn."""
        if self._width:
            typer.echo("", err=True)
        self._width = 0


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
