"""One line on the terminal that says what a long diagnosis is at."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from gap.progress import heard_by

_WIDTH = 70


@contextmanager
def progress_line() -> Iterator[None]:
    """Show stages on stderr, each over the last, and clear the line; nothing but on a terminal."""
    if not sys.stderr.isatty():
        yield
        return

    def show(text: str) -> None:
        print(f"\r{text[:_WIDTH]:{_WIDTH}}", end="", file=sys.stderr, flush=True)

    with heard_by(show):
        try:
            yield
        finally:
            show("")
            print("\r", end="", file=sys.stderr, flush=True)
