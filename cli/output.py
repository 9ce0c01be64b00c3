"""How commands print JSON and write files."""

from __future__ import annotations

import contextlib
import io
import json
import re
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TextIO

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
        what = f"cannot be written: {error.strerror or error}"
        raise PamrigError(str(path), what, "choose another file") from None


def many(count: int, what: str) -> str:
    """A count with its noun, which takes an s: "1 trial", "2 trials"."""
    return f"{count} {what}{'' if count == 1 else 's'}"


def state_findings(findings: Iterable[str], run: str = "") -> None:
    """Print what a check of a record found, if anything, as notes beside a command's result."""
    for text in findings:
        typer.echo(f"NOTE: the record{f' {run}' if run else ''}: {text}", err=True)


_CONTROLS = re.compile(
    r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u200b-\u200f\u2028-\u202e\u2066-\u2069\ufeff]"
)
"""Characters that move the cursor, clear the screen, or reverse or hide text."""


class PlainOutput(io.TextIOWrapper):
    """A text stream that no name from a file or device can control a terminal through.

    Control characters are written as escapes, except line ends, tabs, and one carriage return at
    the start of a text, with which progress lines begin. Characters that the encoding does not
    have, such as half of a surrogate pair, are written as escapes too.
    """

    def write(self, text: str) -> int:
        """Write ``text`` with its control characters escaped."""
        start = "\r" if text.startswith("\r") else ""
        rest = text[len(start) :].replace("\r\n", "\n")
        super().write(start + _CONTROLS.sub(_escaped, rest))
        return len(text)


def _escaped(match: re.Match[str]) -> str:
    return match[0].encode("unicode_escape").decode()


@contextmanager
def plain_output() -> Iterator[None]:
    """Let standard output and standard error write plain text only while the context is open."""
    before = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = map(_plain, before)
    try:
        yield
    finally:
        plain = sys.stdout, sys.stderr
        sys.stdout, sys.stderr = before
        for new, old in zip(plain, before, strict=True):
            if new is not old and isinstance(new, PlainOutput):
                with contextlib.suppress(OSError, ValueError):  # the reader of a pipe has gone
                    new.flush()
                with contextlib.suppress(OSError, ValueError):
                    new.detach()


def _plain(stream: TextIO) -> TextIO:
    buffer = getattr(stream, "buffer", None)
    if buffer is None:  # another program's own stream, or none
        return stream
    stream.flush()
    return PlainOutput(
        buffer,
        encoding=stream.encoding,
        errors="backslashreplace",
        line_buffering=stream.isatty() or stream is sys.stderr,
    )
