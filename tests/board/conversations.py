"""What the conformance tests say to a board, and what CPython's board answers.

The tests run here once, on the firmware's simulated board under this interpreter, and every call
is recorded. The emulated chip must give the same bytes.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from valvefw.deskboard import DeskBoard

from .image import Unusable

TESTS = Path(__file__).resolve().parent.parent
SUITE = "test_valvefw_conformance.py"
CAMPAIGN = (
    "test_valvefw_micropython.py"
    "::test_a_campaign_of_requests_gets_identical_bytes_from_both_interpreters"
)


class _Recorder:
    """A plugin: boards made by the tests write down their calls."""

    def __init__(self) -> None:
        self.conversations: list[dict[str, Any]] = []
        self.name = ""

    def pytest_runtest_setup(self, item: Any) -> None:
        self.name = item.name

    def board(self) -> Callable[[bytes, int], bytes]:
        """A new board, recorded."""
        board = DeskBoard()
        calls: list[tuple[str, int, str]] = []
        self.conversations.append({"name": self.name, "boot": 4660, "calls": calls})

        def talk(data: bytes, ms: int) -> bytes:
            out = board.run(ms, data)
            calls.append((data.hex(), ms, out.hex()))
            return out

        return talk


def recorded(shares: int) -> list[list[dict[str, Any]]]:
    """All conversations, dealt out to so many shares of about the same length.

    Raises:
        Unusable: a test fails under CPython already.
    """
    import pytest

    sys.path.insert(0, str(TESTS))
    import micropython_host

    recorder = _Recorder()
    kept = micropython_host.desk_device
    micropython_host.desk_device = recorder.board
    try:
        status = pytest.main(
            ["-q", "-q", "-p", "no:cacheprovider", "-m", "not look",
             "-k", "micropython or campaign", str(TESTS / SUITE), str(TESTS / CAMPAIGN)],
            plugins=[recorder],
        )  # fmt: skip
    finally:
        micropython_host.desk_device = kept
        sys.path.remove(str(TESTS))
    if status != 0:
        raise Unusable("the conformance tests fail under CPython: run them first")
    if not recorder.conversations:
        raise Unusable("the conformance tests made no board")
    out: list[list[dict[str, Any]]] = [[] for _ in range(shares)]
    spent = [0] * shares
    for talk in sorted(recorder.conversations, key=_length, reverse=True):
        least = spent.index(min(spent))
        out[least].append(talk)
        spent[least] += _length(talk)
    return out


def _length(conversation: dict[str, Any]) -> int:
    return sum(ms + 5 for _, ms, _ in conversation["calls"])
