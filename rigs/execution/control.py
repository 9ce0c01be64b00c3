"""Requests of a person to a running test: pause, resume, skip, repeat, mark, stop.

One place takes them all, from whichever side they come: a line typed at the terminal, a line
in the run's control file (``pamrig runs tell``), or a call.
"""

from __future__ import annotations

import contextlib
import os
import sys
import threading
import time
from collections import deque
from pathlib import Path

from daq.errors import ConfigError
from daq.filelock import try_lock

WORDS = {
    "pause": "hold the test where it is, pressure and all",
    "resume": "go on",
    "skip": "leave out the point that is being made",
    "repeat": "make the last point again",
    "mark": "put a marker with these words into the record",
    "stop": "end the test in good order",
}
SHORT = {"p": "pause", "c": "resume", "s": "skip", "r": "repeat", "m": "mark", "q": "stop"}
"""First letters as typed at the terminal; p pauses, and goes on when it is typed again."""
KEYS = "p pause or continue, s skip, r repeat, m TEXT mark, q stop"
"""The letters, for the terminal."""
SUFFIX = ".control"


REQUEST_S = 30.0
"""`pamrig vent` waits 5 s until its request is taken; an older one was left behind."""
LOCK_AT = 1 << 30
"""Far beyond what is ever asked for: where locks are of bytes, nobody writes there."""


def control_file(folder: Path) -> Path:
    """Where a run listens: beside its folder, so that the record holds nothing else."""
    return folder.with_name(folder.name + SUFFIX)


def is_heard(path: Path) -> bool:
    """Whether a running test listens to a control file; one that nobody hears is removed."""
    try:
        fd = os.open(path, os.O_RDWR)
    except OSError:
        return False
    try:
        heard = not try_lock(fd, LOCK_AT)
    finally:
        os.close(fd)
    if not heard:
        with contextlib.suppress(OSError):
            path.unlink(missing_ok=True)
    return heard


def clear_stale(root: Path) -> None:
    """Remove the control files of tests whose program was killed."""
    for path in root.glob(f"*{SUFFIX}"):
        is_heard(path)


def is_request(text: str) -> bool:
    """Whether a typed line is a request to the test."""
    first = text.partition(" ")[0].lower()
    return first in SHORT or first in WORDS


class RunControl:
    """Requests on their way to a running test; may be used from any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._asked: deque[tuple[str, str]] = deque()
        self._file: Path | None = None
        self._fd = -1
        self._read = 0
        self._vent: Path | None = None

    def request(self, text: str) -> None:
        """Ask for something: a word of ``WORDS`` or its letter, then what to mark.

        Raises:
            ConfigError: no such word.
        """
        first, _, rest = text.strip().partition(" ")
        word = SHORT.get(first.lower(), first.lower())
        if word not in WORDS:
            known = ", ".join(f"{k} {v}" for k, v in SHORT.items())
            raise ConfigError(f"{first!r}", "is not a request to a test", known)
        with self._lock:
            self._asked.append((word if first.lower() != "p" else "p", rest.strip()))

    def typed(self, line: str) -> None:
        """A line that was typed at the terminal while no request was open there."""
        try:
            self.request(line)
        except ConfigError as error:
            print(error, file=sys.stderr, flush=True)

    def listen(self, path: Path, vent: Path | None = None) -> None:
        """Also take whole lines that are appended to a file, from now on.

        The file is locked, so that one which a killed program left behind can be told from it.
        ``vent`` is a file whose appearance asks for the end of the test (``pamrig vent``).
        """
        clear_stale(path.parent)
        self._vent = vent
        with contextlib.suppress(OSError):
            self._fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_TRUNC, 0o644)
            try_lock(self._fd, LOCK_AT)
            self._file = path
        self._read = 0

    def close(self) -> None:
        """Stop listening to the file and remove it."""
        if self._file is not None:
            with contextlib.suppress(OSError):
                os.close(self._fd)
            with contextlib.suppress(OSError):
                self._file.unlink(missing_ok=True)
        self._file = None

    def look(self) -> None:
        """Read what the file has gained; lines that ask for nothing known are left out."""
        if self._vent is not None and self._vent.exists():
            fresh = False
            with contextlib.suppress(OSError):
                # Wall time, as the file system stamps it; one of a killed `vent` asks nothing.
                fresh = abs(time.time() - self._vent.stat().st_mtime) < REQUEST_S
                self._vent.unlink()
            if fresh:
                self.request("stop")
        if self._file is None:
            return
        try:
            gained = os.fstat(self._fd).st_size - self._read
            if gained <= 0:
                return
            os.lseek(self._fd, self._read, os.SEEK_SET)
            data = os.read(self._fd, gained)
        except OSError:
            return
        whole = data[: data.rfind(b"\n") + 1]
        self._read += len(whole)
        for line in whole.decode(errors="replace").splitlines():
            with contextlib.suppress(ConfigError):
                if line.strip():
                    self.request(line)

    def take(self) -> tuple[str, str] | None:
        """The oldest request, (word, rest), or None."""
        with self._lock:
            return self._asked.popleft() if self._asked else None
