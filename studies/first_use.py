"""The wait for the compiler, told of to who sits before it."""

from __future__ import annotations

import contextlib
import sys
import threading
from collections.abc import Iterator

PATIENCE_S = 2.0
WORDS = (
    "loading the simulation; the first time after an installation it is compiled, "
    "which takes up to a minute"
)


@contextlib.contextmanager
def tell_of_compiling(quiet: bool = False) -> Iterator[None]:
    """Say on a terminal's stderr why nothing happens, if what is inside takes its time.

    Args:
        quiet: say nothing; so it is anyway where stderr is no terminal.
    """
    if quiet or not sys.stderr.isatty():
        yield
        return
    timer = threading.Timer(PATIENCE_S, lambda: print(WORDS, file=sys.stderr, flush=True))
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
