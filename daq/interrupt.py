"""Stopping by signal: Ctrl-C, SIGTERM and a closed terminal end a run in good order."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator
from types import FrameType


class Stopped(Exception):
    """The operator (or the machine) asked the run to end."""


class StopFlag:
    """Set by a signal handler, looked at by the run's loop."""

    def __init__(self) -> None:
        self.reason = ""

    def set(self, reason: str) -> None:
        """Ask for the end of the run; the first reason stays."""
        self.reason = self.reason or reason

    def check(self) -> None:
        """Raises Stopped when the end was asked for."""
        if self.reason:
            raise Stopped(self.reason)


@contextlib.contextmanager
def stop_on_signals() -> Iterator[StopFlag]:
    """Turn SIGINT, SIGTERM and SIGHUP into a flag while inside; pressed twice or not."""
    flag = StopFlag()
    if threading.current_thread() is not threading.main_thread():
        yield flag  # signals reach the main thread only
        return

    def handler(number: int, frame: FrameType | None) -> None:
        del frame
        flag.set(signal.Signals(number).name)

    names = [n for n in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK") if hasattr(signal, n)]
    before = {n: signal.signal(getattr(signal, n), handler) for n in names}
    try:
        yield flag
    finally:
        for name, old in before.items():
            signal.signal(getattr(signal, name), old)
