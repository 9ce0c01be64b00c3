"""The command `pamrig study NAME`."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Iterator
from importlib import import_module
from pathlib import Path
from typing import TypeVar

import typer

from daq.errors import RecordError
from daq.interrupt import StopFlag, Stopped, stop_on_signals
from studies.first_use import ProgressLine, compilation_message

T = TypeVar("T")


def study_command(name: str, full: bool, out: Path | None, as_json: bool) -> int:
    """Run a study, print its results, draw its figures; returns the exit status."""
    with compilation_message(quiet=as_json):
        module = import_module(f"studies.schemes.{name}")
    with stop_on_signals() as stop:
        progress = Progress(stop, quiet=as_json or not sys.stderr.isatty())
        try:
            study = module.run(full, progress)
        except Stopped as stopped:
            typer.echo(f"study {name}: stopped ({stopped}), no results", err=True)
            return 130
        progress.close()
    if as_json:
        typer.echo(json.dumps(study.as_json(), indent=2, allow_nan=False))
    else:
        typer.echo(study.markdown())
    if out is not None:
        from analysis.figures.drawing import as_png

        try:
            out.mkdir(parents=True, exist_ok=True)
            for title, draw in study.figures.items():
                path = out / f"study-{title}.png"
                path.write_bytes(as_png(draw(), 130))
                if not as_json:
                    typer.echo(f"figure: {path}", err=True)
        except OSError as error:
            raise RecordError(str(out), f"cannot be written: {error.strerror}") from None
    return 0


class Progress:
    """Shows the progress of a study; a signal stops it between two parts."""

    def __init__(self, stop: StopFlag | None = None, quiet: bool = True) -> None:
        self._stop = stop
        self._line = ProgressLine(quiet)

    def over(self, items: Iterable[T], what: str) -> Iterator[T]:
        """Iterate over the items and show the progress."""
        listed = list(items)
        for index, item in enumerate(listed):
            if self._stop is not None:
                self._stop.check()
            self._line.show(f"{what}  {index + 1} of {len(listed)}")
            yield item

    def close(self) -> None:
        """Move the cursor to a new line."""
        self._line.close()
