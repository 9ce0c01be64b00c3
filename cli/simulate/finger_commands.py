"""What `pamrig study finger`, `controllers`, `pressure` and `tuning` do."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import typer

from daq.errors import ConfigError
from daq.interrupt import StopFlag, Stopped, stop_on_signals
from plant.errors import PlantError
from studies.first_use import compilation_message

if TYPE_CHECKING:
    from studies.comparison.spread import Outcome
    from studies.comparison.study import Row

T = TypeVar("T")
STOPPED = 130


@contextmanager
def _one_line_errors() -> Iterator[None]:
    """What the plant refuses is the user's to put right: one line, exit status 2."""
    try:
        yield
    except PlantError as error:
        what, _, remedy = str(error).partition("; ")
        raise ConfigError("study", what, remedy) from None


def finger_command(
    source: str, laws: str, valve: str, seeds: int, page: bool, as_json: bool
) -> int:
    """Step and circle on one valve, without and with payload; returns the exit status.

    Raises:
        ConfigError: a finger, valve or controller that cannot be.
    """
    with compilation_message(quiet=as_json):
        from studies.comparison.report import as_markdown, as_text
        from studies.comparison.study import table

    with _one_line_errors(), stop_on_signals() as stop:
        told = _progress(as_json, stop)
        rows = table(_load(source), _split(laws), (valve,), seeds=_draws(seeds), progress=told)
        found, status = _as_far_as_it_goes(rows)
    return _say(found, as_markdown if page else as_text, as_json, status)


def controllers_command(
    source: str,
    laws: str,
    perturbed: bool,
    seeds: int,
    figures: Path | None,
    page: bool,
    as_json: bool,
) -> int:
    """The table of all controllers; returns the exit status.

    Raises:
        ConfigError: a finger or controller that cannot be, a folder that cannot be written.
    """
    with compilation_message(quiet=as_json):
        from studies.comparison.report import as_markdown, as_text, plants_markdown
        from studies.comparison.study import PERTURBED, table
        from studies.controllers.laws import HOST_LAWS, LAWS

    with _one_line_errors(), stop_on_signals() as stop:
        told = _progress(as_json, stop)
        finger = _load(source)
        everything = HOST_LAWS if perturbed else LAWS
        chosen = list(everything) if laws == "all" else _split(laws)
        if perturbed:
            rows = table(finger, chosen, ("cured",), PERTURBED, _draws(seeds), told)
        else:
            rows = table(finger, chosen, seeds=_draws(seeds), progress=told)
        found, status = _as_far_as_it_goes(rows)
        drawn = _draw(finger, figures) if figures is not None and not status else []
    on_page = plants_markdown if perturbed and not status else as_markdown
    _say(found, on_page if page else as_text, as_json, status)
    if not as_json:
        for path in drawn:
            typer.echo(f"figure: {path}", err=True)
    return status


def _as_far_as_it_goes(rows: Iterable[T]) -> tuple[list[T], int]:
    """What was finished before a signal, if one came, and the exit status."""
    found: list[T] = []
    try:
        for row in rows:
            found.append(row)
    except Stopped as stopped:
        typer.echo(f"stopped ({stopped}); what was finished is below", err=True)
        return found, STOPPED
    return found, 0


def _say(rows: list[Row], show: Callable[[list[Outcome]], str], as_json: bool, status: int) -> int:
    from studies.comparison.spread import over_draws

    outcomes = over_draws(rows)
    if as_json:
        value = {
            "whole": not status,
            "outcomes": [outcome.as_dict() for outcome in outcomes],
            "draws": [row.as_dict() for row in rows],
        }
        typer.echo(json.dumps(value, allow_nan=False))
    else:
        typer.echo(show(outcomes))
    return status


def pressure_command(seeds: int, page: bool, as_json: bool) -> int:
    """The table of controllers of a pressure; returns the exit status.

    Raises:
        ConfigError: a critical gain that cannot be found.
    """
    with compilation_message(quiet=as_json):
        from studies.comparison.pressure import pressure_table
        from studies.comparison.report import pressure_markdown, pressure_text

    with _one_line_errors(), stop_on_signals() as stop:
        rows = pressure_table(seeds=_draws(seeds), progress=_progress(as_json, stop))
        found, status = _as_far_as_it_goes(rows)
    if as_json:
        value = {"whole": not status, "outcomes": [row.as_dict() for row in found]}
        typer.echo(json.dumps(value, allow_nan=False))
    else:
        typer.echo((pressure_markdown if page else pressure_text)(found))
    return status


def tuning_command(source: str, valve: str, as_json: bool) -> None:
    """What the tuning rules were given and made, on one valve.

    Raises:
        ConfigError: a finger or valve that cannot be, a critical gain that cannot be found.
    """
    with compilation_message(quiet=as_json):
        from plant.finger.reader import load_valve
        from studies.comparison.provenance import provenance

    with _one_line_errors():
        found = provenance(_load(source), load_valve(valve), _progress(as_json))
    typer.echo(json.dumps(found.as_dict(), allow_nan=False) if as_json else found.text())


def _draw(finger: Any, folder: Path) -> list[Path]:
    from studies.comparison.pictures import draw_circles, draw_steps

    try:
        folder.mkdir(parents=True, exist_ok=True)
        return [draw_steps(finger, folder), draw_circles(finger, folder)]
    except OSError as error:
        raise ConfigError("figures", f"{folder} cannot be written ({error})", "") from None


def _load(source: str) -> Any:
    from plant.finger import load_finger

    return load_finger(source)


def _split(laws: str) -> list[str]:
    return [law.strip() for law in laws.split(",") if law.strip()]


def _draws(seeds: int) -> range:
    return range(1, seeds + 1)


def _progress(quiet: bool, stop: StopFlag | None = None) -> Callable[[str], None]:
    """Says what comes next; a signal stops a study there."""

    def tell(text: str) -> None:
        if stop is not None:
            stop.check()
        if not quiet:
            print(text, file=sys.stderr, flush=True)

    return tell
