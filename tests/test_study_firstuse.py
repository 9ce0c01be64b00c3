"""The wait for the compiler: told of on a terminal, to nobody else."""

from __future__ import annotations

import os
import select
import sys
import time
from collections.abc import Iterator
from typing import TextIO

import pytest

from studies import first_use as firstuse
from studies.first_use import MESSAGE, compilation_message

pytestmark = pytest.mark.realtime
pty = pytest.importorskip("pty", reason="no terminals of this kind on this system")


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[int, TextIO]]:
    """A real terminal for stderr to go to, and the descriptor from which it can be read."""
    ours, theirs = pty.openpty()
    monkeypatch.setattr(firstuse, "DELAY_S", 0.05)
    with os.fdopen(theirs, "w") as stream:
        os.set_blocking(ours, False)
        yield ours, stream
    os.close(ours)


def shown(terminal: int, wait_s: float) -> str:
    end = time.monotonic() + wait_s
    text = b""
    while time.monotonic() < end and MESSAGE.encode() not in text:
        try:
            text += os.read(terminal, 4096)
        except BlockingIOError:
            select.select([terminal], [], [], 0.02)
    return text.decode()


# stderr is replaced within each test: what catches the output of tests sets it anew before them.
def test_a_long_wait_is_told_of(
    terminal: tuple[int, TextIO], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "stderr", terminal[1])
    with compilation_message():
        assert MESSAGE in shown(terminal[0], 120.0)


def test_a_short_one_is_not(terminal: tuple[int, TextIO], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", terminal[1])
    with compilation_message():
        pass
    assert shown(terminal[0], 0.3) == ""


def test_neither_is_anybody_who_asked_for_quiet(
    terminal: tuple[int, TextIO], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "stderr", terminal[1])
    with compilation_message(quiet=True):
        assert shown(terminal[0], 0.3) == ""
