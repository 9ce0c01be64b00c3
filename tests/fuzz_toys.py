"""Readers with known faults, for the fuzzer to find."""

from __future__ import annotations

import ctypes
from collections import deque
from itertools import repeat

from tests.fuzz.loop import Target
from tests.fuzz_toys_read import deep

HOARD: list[bytes] = []


def _crash(data: bytes) -> None:
    if b"\x7f" in data:
        ctypes.string_at(8)


def _native_hang(data: bytes) -> None:
    if b"\x7f" in data:
        deque(repeat(0), maxlen=0)  # never comes back to Python, where an alarm could reach it


def _hoard(data: bytes) -> None:
    HOARD.append(data * 200_000)


def _toy(name: str, run: object) -> Target:
    return Target(name, "a toy", run, [b"abc"], (ValueError,))  # type: ignore[arg-type]


TARGETS = {
    "crash": lambda: _toy("crash", _crash),
    "native hang": lambda: _toy("native hang", _native_hang),
    "hoard": lambda: _toy("hoard", _hoard),
    "deep": lambda: _toy("deep", deep),
}
