"""What `pamrig study finger` and `pamrig study controllers` do."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import typer

from daq.errors import ConfigError
from plant.errors import PlantError


@contextmanager
def _one_line_errors() -> Iterator[None]:
    """What the plant refuses is the user's to put right: one line, exit status 2."""
    try:
        yield
    except PlantError as error:
        what, _, remedy = str(error).partition("; ")
        raise ConfigError("study", what, remedy) from None


def finger_command(source: str, laws: str, valve: str, as_json: bool) -> None:
    """Step and circle on one valve, without and with payload.

    Raises:
        ConfigError: a finger, valve or controller that cannot be.
    """
    from rigs.controllers.report import as_text
    from rigs.controllers.study import table

    with _one_line_errors():
        finger = _load(source)
        rows = table(finger, _split(laws), (valve,), progress=_progress(as_json))
    if as_json:
        typer.echo(json.dumps([row.as_dict() for row in rows], allow_nan=False))
        return
    typer.echo(as_text(rows))


def controllers_command(
    source: str, laws: str, perturbed: bool, figures: Path | None, as_json: bool
) -> None:
    """The table of all controllers.

    Raises:
        ConfigError: a finger or controller that cannot be, a folder that cannot be written.
    """
    from rigs.controllers.laws import HOST_LAWS, LAWS
    from rigs.controllers.report import as_text
    from rigs.controllers.study import perturbed as run_perturbed
    from rigs.controllers.study import table

    with _one_line_errors():
        finger = _load(source)
        everything = HOST_LAWS if perturbed else LAWS
        chosen = list(everything) if laws == "all" else _split(laws)
        if perturbed:
            rows = run_perturbed(finger, chosen, progress=_progress(as_json))
        else:
            rows = table(finger, chosen, progress=_progress(as_json))
        drawn = _draw(finger, figures) if figures is not None else []
    if as_json:
        typer.echo(json.dumps([row.as_dict() for row in rows], allow_nan=False))
        return
    typer.echo(as_text(rows))
    for path in drawn:
        typer.echo(f"figure: {path}")


def pressure_command(as_json: bool) -> None:
    """The table of controllers of a pressure.

    Raises:
        ConfigError: a critical gain that cannot be found.
    """
    from rigs.controllers.pressure import pressure_table
    from rigs.controllers.report import pressure_text

    with _one_line_errors():
        rows = pressure_table()
    if as_json:
        typer.echo(json.dumps([row.as_dict() for row in rows], allow_nan=False))
        return
    typer.echo(pressure_text(rows))


def _draw(finger: Any, folder: Path) -> list[Path]:
    from rigs.controllers.pictures import draw_circles, draw_steps

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


def _progress(quiet: bool) -> Callable[[str], None]:
    def tell(text: str) -> None:
        if not quiet:
            print(text, file=sys.stderr, flush=True)

    return tell
