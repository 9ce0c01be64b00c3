"""Messages on the terminal: progress, and the compilation of the simulation at first use."""

from __future__ import annotations

import contextlib
import sys
import threading
from collections.abc import Iterator

DELAY_S = 2.0
MESSAGE = (
    "loading the simulation; the first time after an installation it is compiled, "
    "which takes up to a minute"
)


@contextlib.contextmanager
def compilation_message(quiet: bool = False) -> Iterator[None]:
    """Print a message on stderr if the code inside takes longer than ``DELAY_S``.

    Args:
        quiet: print nothing. Nothing is printed either if stderr is not a terminal.
    """
    if quiet or not sys.stderr.isatty():
        yield
        return
    timer = threading.Timer(DELAY_S, lambda: print(MESSAGE, file=sys.stderr, flush=True))
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


class ProgressLine:
    """One line on stderr that each call of `show` overwrites."""

    def __init__(self, quiet: bool) -> None:
        self._quiet = quiet
        self._shown = False

    def show(self, text: str) -> None:
        """Show a text in place of the last one."""
        if not self._quiet:
            print(f"\r{text}   ", end="", file=sys.stderr, flush=True)
            self._shown = True

    def close(self) -> None:
        """Move the cursor to a new line."""
        if self._shown:
            print(file=sys.stderr)
            self._shown = False
