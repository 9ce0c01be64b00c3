"""`pamrig study finger|controllers|pressure|tuning`: studies of the finger and its controllers."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from cli.options import JsonOption
from cli.output import print_json, writing
from daq.interrupt import StopFlag, Stopped, stop_on_signals

if TYPE_CHECKING:
    from plant.finger import Finger
    from studies.comparison.spread import Outcome
    from studies.comparison.study import Row

PageOption = Annotated[bool, typer.Option("--page", help="Print the table as Markdown.")]
SeedsOption = Annotated[
    int, typer.Option("--seeds", min=1, max=1000, help="Noise realizations, seeds 1, 2, ...")
]
FingerOption = Annotated[str, typer.Option("--finger", help="Finger file, or a shipped one.")]
ValveOption = Annotated[str, typer.Option("--valve", help="Valve file, or a shipped one.")]
LawsOption = Annotated[str, typer.Option("--laws", help="Controllers, separated by commas.")]
T = TypeVar("T")
STOPPED = 130


def add_finger_studies(app: typer.Typer) -> None:
    """Add the studies of the finger to `pamrig study`."""
    for command in (finger, controllers, pressure, tuning):
        app.command()(command)


def finger(
    finger: FingerOption = "finger",
    laws: LawsOption = "feedforward,adaptive",
    valve: ValveOption = "cured",
    seeds: SeedsOption = 1,
    page: PageOption = False,
    as_json: JsonOption = False,
) -> None:
    """Whether a controller holds a joint and follows a fingertip circle, with and without 20 g."""
    from studies.first_use import compilation_message

    with compilation_message(quiet=as_json):
        from plant.finger import load_finger
        from studies.comparison.report import as_markdown, as_text
        from studies.comparison.study import table

    with _user_errors(), stop_on_signals() as stop:
        progress = _progress(as_json, stop)
        rows, status = _until_stopped(
            table(
                load_finger(finger), _split(laws), (valve,), seeds=_draws(seeds), progress=progress
            )
        )
    _print_rows(rows, as_markdown if page else as_text, as_json, status)
    raise typer.Exit(status)


def pressure(seeds: SeedsOption = 5, page: PageOption = False, as_json: JsonOption = False) -> None:
    """Compare controllers of one muscle's pressure on both valves."""
    from studies.first_use import compilation_message

    with compilation_message(quiet=as_json):
        from studies.comparison.pressure import pressure_table
        from studies.comparison.report import pressure_markdown, pressure_text

    with _user_errors(), stop_on_signals() as stop:
        rows, status = _until_stopped(
            pressure_table(seeds=_draws(seeds), progress=_progress(as_json, stop))
        )
    if as_json:
        print_json({"whole": not status, "outcomes": [row.as_dict() for row in rows]}, None)
    else:
        typer.echo((pressure_markdown if page else pressure_text)(rows))
    raise typer.Exit(status)


def tuning(
    finger: FingerOption = "finger", valve: ValveOption = "cured", as_json: JsonOption = False
) -> None:
    """Where the gains come from, and how loops behave when tuned one at a time; takes a minute."""
    from studies.first_use import compilation_message

    with compilation_message(quiet=as_json):
        from plant.finger import load_finger
        from plant.finger.reader import load_valve
        from studies.comparison.provenance import provenance

    with _user_errors():
        found = provenance(load_finger(finger), load_valve(valve), _progress(as_json))
    if as_json:
        print_json(found.as_dict(), None)
    else:
        typer.echo(found.text())


def controllers(
    finger: FingerOption = "finger",
    laws: LawsOption = "all",
    perturbed: Annotated[
        bool, typer.Option("--perturbed", help="Host laws on plants they do not know.")
    ] = False,
    seeds: SeedsOption = 5,
    figures: Annotated[
        Path | None, typer.Option("--figures", help="Folder to write figures to.")
    ] = None,
    page: PageOption = False,
    as_json: JsonOption = False,
) -> None:
    """All controllers on both valves, with and without payload; takes some minutes."""
    from studies.first_use import compilation_message

    with compilation_message(quiet=as_json):
        from plant.finger import load_finger
        from studies.comparison.report import as_markdown, as_text, plants_markdown
        from studies.comparison.study import PERTURBED, table
        from studies.controllers.laws import HOST_LAWS, LAWS

    with _user_errors(), stop_on_signals() as stop:
        progress = _progress(as_json, stop)
        loaded = load_finger(finger)
        known = HOST_LAWS if perturbed else LAWS
        chosen = list(known) if laws == "all" else _split(laws)
        if perturbed:
            made = table(loaded, chosen, ("cured",), PERTURBED, _draws(seeds), progress)
        else:
            made = table(loaded, chosen, seeds=_draws(seeds), progress=progress)
        rows, status = _until_stopped(made)
        drawn = _draw(loaded, figures) if figures is not None and not status else []
    markdown = plants_markdown if perturbed and not status else as_markdown
    _print_rows(rows, markdown if page else as_text, as_json, status)
    if not as_json:
        for path in drawn:
            typer.echo(f"figure: {path}", err=True)
    raise typer.Exit(status)


@contextmanager
def _user_errors() -> Iterator[None]:
    """Turn a PlantError into a user error: one line, exit status 2."""
    from daq.errors import ConfigError
    from plant.errors import PlantError

    try:
        yield
    except PlantError as error:
        what, _, remedy = str(error).partition("; ")
        raise ConfigError("study", what, remedy) from None


def _until_stopped(rows: Iterable[T]) -> tuple[list[T], int]:
    """The rows finished before a signal, if one came, and the exit status."""
    found: list[T] = []
    try:
        for row in rows:
            found.append(row)
    except Stopped as stopped:
        typer.echo(f"stopped ({stopped}); the finished rows are below", err=True)
        return found, STOPPED
    return found, 0


def _print_rows(
    rows: list[Row], to_text: Callable[[list[Outcome]], str], as_json: bool, status: int
) -> None:
    from studies.comparison.spread import over_draws

    outcomes = over_draws(rows)
    if as_json:
        value = {
            "whole": not status,
            "outcomes": [outcome.as_dict() for outcome in outcomes],
            "draws": [row.as_dict() for row in rows],
        }
        print_json(value, None)
    else:
        typer.echo(to_text(outcomes))


def _draw(finger: Finger, folder: Path) -> list[Path]:
    from studies.comparison.pictures import draw_circles, draw_steps

    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        return [draw_steps(finger, folder), draw_circles(finger, folder)]


def _split(laws: str) -> list[str]:
    return [law.strip() for law in laws.split(",") if law.strip()]


def _draws(seeds: int) -> range:
    return range(1, seeds + 1)


def _progress(quiet: bool, stop: StopFlag | None = None) -> Callable[[str], None]:
    """A callback that prints the next step, and stops a study there after a signal."""

    def show(text: str) -> None:
        if stop is not None:
            stop.check()
        if not quiet:
            print(text, file=sys.stderr, flush=True)

    return show
