"""A message on the terminal while the simulation is compiled for the first time."""

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
