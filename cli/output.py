"""How commands print JSON and write files."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import typer

from daq.errors import PamrigError


def print_json(value: Any, indent: int | None = 2) -> None:
    """Print one JSON value.

    Raises:
        ValueError: the value contains nan or infinity.
    """
    typer.echo(json.dumps(value, indent=indent, allow_nan=False))


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn an OSError into a PamrigError that names the file.

    Raises:
        PamrigError: the file cannot be written.
    """
    try:
        yield
    except OSError as error:
        raise PamrigError(str(path), f"cannot be written: {error}", "choose another file") from None
