"""One line on the terminal that says what a long command is at, and for how long already.

It stands on stderr, only where that is a terminal, and it is gone when the command prints.
"""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TypeVar

from daq.progress import heard_by

T = TypeVar("T")

WIDTH = 76
AFTER_S = 0.3
"""A command that takes less shows nothing."""
EVERY_S = 0.25
SECONDS_FROM_S = 2.0
"""From here on the line shows the time that it has taken."""


class _Line:
    """The line; a thread draws it, so that it moves in the middle of a long calculation."""

    def __init__(self, text: str) -> None:
        self._text = text
        self._start = time.monotonic()
        self._end = threading.Event()
        self._shown = False
        self._thread = threading.Thread(target=self._draw, name="progress", daemon=True)
        self._thread.start()

    def say(self, text: str) -> None:
        """What the command is at now; drawn with the next look."""
        self._text = text

    def _draw(self) -> None:
        wait = AFTER_S
        while not self._end.wait(wait):
            wait = EVERY_S
            took_s = time.monotonic() - self._start
            seconds = f"  {took_s:.0f} s" if took_s >= SECONDS_FROM_S else ""
            self._put(f"{self._text[: WIDTH - len(seconds)]}{seconds}")
            self._shown = True

    def _put(self, text: str) -> None:
        print(f"\r{text:{WIDTH}}", end="", file=sys.stderr, flush=True)

    def close(self) -> None:
        """Clear the line."""
        self._end.set()
        self._thread.join()
        if self._shown:
            self._put("")
            print("\r", end="", file=sys.stderr, flush=True)


@contextmanager
def interrupt_kept() -> Iterator[Callable[[], None]]:
    """Ctrl-C counts inside, also where it is pressed while a library takes it for its own error.

    An import that tries what is installed, or the end of an object's life, may swallow it. Gives a
    function that raises it again.

    Raises:
        KeyboardInterrupt: at once, from that function, or at the end of the context.
    """
    pressed = threading.Event()

    def handler(number: int, frame: FrameType | None) -> None:
        pressed.set()
        signal.default_int_handler(number, frame)

    def again() -> None:
        if pressed.is_set():
            raise KeyboardInterrupt

    in_main = threading.current_thread() is threading.main_thread()
    if not in_main or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield lambda: None  # somebody else keeps it
        return
    signal.signal(signal.SIGINT, handler)
    try:
        yield again
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    again()


@contextmanager
def progress_line(what: str = "") -> Iterator[Callable[[str], None]]:
    """Show ``what``, then every stage that is reported inside (`daq.progress`), and the time.

    Gives a function that shows another text. Nothing inside may print.
    """
    if not sys.stderr.isatty():
        yield lambda text: None
        return
    line = _Line(what or "working")
    try:
        with interrupt_kept() as interrupt:

            def say(text: str) -> None:
                interrupt()
                line.say(text)

            with heard_by(say):
                yield say
    finally:
        line.close()


def counting(items: Iterable[T], what: str) -> Iterator[T]:
    """The items; their number is shown where they are not printed on the terminal themselves."""
    if sys.stdout.isatty():
        yield from items
        return
    with progress_line(what) as say:
        for number, item in enumerate(items, 1):
            say(f"{what}: {number}")
            yield item
