"""Signals (Ctrl-C, SIGTERM, closed terminal) as a request for an orderly stop."""

from __future__ import annotations

import contextlib
import os
import signal
import stat
import threading
from collections.abc import Iterator
from types import FrameType

REASONS = {
    "SIGINT": "stopped by Ctrl-C",
    "SIGTERM": "ended by another program (SIGTERM)",
    "SIGHUP": "the terminal was closed",
    "SIGBREAK": "stopped by Ctrl-Break",
}


class Stopped(Exception):
    """The operator or the system requested the end of the run."""


class StopFlag:
    """A stop request: a signal handler sets it, the run's loop checks it."""

    def __init__(self) -> None:
        self.reason = ""

    def set(self, reason: str) -> None:
        """Request the end of the run; the first reason is kept."""
        self.reason = self.reason or reason

    def check(self) -> None:
        """Raise Stopped if the end was requested."""
        if self.reason:
            raise Stopped(self.reason)


def _leave_terminal() -> None:
    """Send what is still printed nowhere: to write to a closed terminal is an error, which would
    end the program before table and report are made.
    """
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for fd in (1, 2):
        with contextlib.suppress(OSError):
            if stat.S_ISCHR(os.fstat(fd).st_mode):  # isatty says no once the terminal is gone
                os.dup2(nowhere, fd)
    os.close(nowhere)


@contextlib.contextmanager
def stop_on_signals() -> Iterator[StopFlag]:
    """Convert SIGINT, SIGTERM and SIGHUP into a flag inside the context; its reason is in words."""
    flag = StopFlag()
    if threading.current_thread() is not threading.main_thread():
        yield flag  # signals reach the main thread only
        return

    def handler(number: int, frame: FrameType | None) -> None:
        del frame
        name = signal.Signals(number).name
        if name == "SIGHUP":
            _leave_terminal()
        flag.set(REASONS.get(name, name))

    names = [n for n in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK") if hasattr(signal, n)]
    before = {n: signal.signal(getattr(signal, n), handler) for n in names}
    try:
        yield flag
    finally:
        for name, old in before.items():
            signal.signal(getattr(signal, name), old)
