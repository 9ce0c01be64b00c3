"""What the shell offers when Tab is pressed: runs, shipped rigs, protocols and models."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable
from importlib import resources
from pathlib import Path

import typer

NEWEST_RUNS = 20


def run_names(context: typer.Context, incomplete: str) -> list[str]:
    """``last`` and the newest runs of the folder that ``--runs`` names, newest first."""
    from daq.errors import PamrigError
    from daq.record.runname import by_start

    folder = Path(str(context.params.get("runs") or "runs"))
    names: list[str] = []
    with contextlib.suppress(OSError, PamrigError):
        found = (path.parent for path in folder.glob("*/run.json"))
        names = [path.name for path in sorted(found, key=by_start, reverse=True)]
    return _matching(["last", *names[:NEWEST_RUNS]], incomplete)


def shipped(folder: str) -> Callable[[str], list[str]]:
    """A completer for the names of the files shipped in ``configs/<folder>``."""

    def names(incomplete: str) -> list[str]:
        entries = (resources.files("configs") / folder).iterdir()
        stems = sorted(e.name[:-5] for e in entries if e.name.endswith(".toml"))
        return _matching(stems, incomplete)

    return names


def model_names(incomplete: str) -> list[str]:
    """Names of the muscle models."""
    from plant.models import catalogue

    return _matching(catalogue.names(), incomplete)


def _matching(names: Iterable[str], incomplete: str) -> list[str]:
    """The names that begin with what was typed; if there are none, those that contain it."""
    names = list(names)
    begin = [name for name in names if name.startswith(incomplete)]
    return begin or [name for name in names if incomplete in name]
