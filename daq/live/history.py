"""What is drawn of a test, as bytes for viewers that connect early or late.

Rerun encodes a recording as a header and messages: 8 bytes of kind, 8 bytes of length, content.
Each reading of its buffer ends with an end mark, which is left out here, so that the parts of the
stream can be sent one after another.
"""

from __future__ import annotations

import asyncio
import struct
import threading
from collections import deque
from collections.abc import AsyncIterator, Iterator
from pathlib import Path

HEADER = 12
POLL_S = 0.03
BLOCK = 1 << 18
_HEAD = struct.Struct("<QQ")
_END, _DATA = 0, 2
_STATIC = 7  # field of a data message: it holds at all times, such as a curve's colour


class History:
    """The stream so far, at most ``limit`` bytes: its oldest data are dropped first.

    What a late viewer cannot do without is kept: the arrangement of the views, and what is drawn
    at all times.
    """

    size: int | None = None
    """Of the whole stream in bytes; unknown while it grows."""

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._lock = threading.Lock()
        self._header = b""
        self._messages: dict[int, bytes] = {}
        self._droppable: deque[int] = deque()
        self._held = 0
        self.newest = 0
        self.ended = False

    def add(self, stream: bytes) -> None:
        """Append what Rerun has encoded since the last call."""
        with self._lock:
            self._header = self._header or stream[:HEADER]
            for kind, message in _messages(stream):
                self.newest += 1
                self._messages[self.newest] = message
                self._held += len(message)
                if kind == _DATA and not _is_static(message[_HEAD.size :]):
                    self._droppable.append(self.newest)
            while self._held > self._limit and self._droppable:
                self._held -= len(self._messages.pop(self._droppable.popleft()))

    def end(self) -> None:
        """Nothing more comes: readers end when they have read all."""
        self.ended = True

    async def read(self) -> AsyncIterator[bytes]:
        """All that is held, then all that comes; what is dropped meanwhile is passed over."""
        with self._lock:
            last, wanted = self.newest, list(self._messages)
            header = self._header
        yield header
        while True:
            for block in self._blocks(wanted):
                yield block
            if self.newest > last:
                wanted, last = list(range(last + 1, self.newest + 1)), self.newest
            elif self.ended:
                return
            else:
                wanted = []
                await asyncio.sleep(POLL_S)

    def _blocks(self, wanted: list[int]) -> Iterator[bytes]:
        parts, size = [], 0
        for number in wanted:
            message = self._messages.get(number, b"")
            parts.append(message)
            size += len(message)
            if size > BLOCK:
                yield b"".join(parts)
                parts, size = [], 0
        if size:
            yield b"".join(parts)


class ViewFile:
    """A finished view file as the same kind of stream."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.size: int | None = path.stat().st_size

    async def read(self) -> AsyncIterator[bytes]:
        """The whole file, block by block."""
        with self._path.open("rb") as file:
            while block := file.read(BLOCK):
                yield block


def _messages(stream: bytes) -> Iterator[tuple[int, bytes]]:
    """Kind and bytes of each message up to the end mark."""
    at = HEADER
    while at + _HEAD.size <= len(stream):
        kind, size = _HEAD.unpack_from(stream, at)
        if kind == _END:
            return
        end = at + _HEAD.size + size
        yield kind, stream[at:end]
        at = end


def _is_static(data: bytes) -> bool:
    """Whether a data message (protobuf) sets its field for static data; unreadable: yes."""
    at = 0
    try:
        while at < len(data):
            key, at = _varint(data, at)
            field, form = key >> 3, key & 7
            if form == 0:
                value, at = _varint(data, at)
                if field == _STATIC:
                    return bool(value)
            elif form == 2:
                size, at = _varint(data, at)
                at += size
            else:
                at += {1: 8, 5: 4}[form]
    except (IndexError, KeyError):
        return True
    return False


def _varint(data: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = data[at]
        at += 1
        value |= (byte & 127) << shift
        shift += 7
        if byte < 128:
            return value, at
