"""`python -m gap.check`: the same command as `pamrig gap check`."""

from __future__ import annotations

import sys

import typer

from cli.gap.check import add_check
from daq.errors import PamrigError

if __name__ == "__main__":
    app = typer.Typer(pretty_exceptions_enable=False, add_completion=False)
    add_check(app)
    try:
        app()
    except PamrigError as error:
        typer.echo(f"pamrig: {error}", err=True)
        sys.exit(2)
