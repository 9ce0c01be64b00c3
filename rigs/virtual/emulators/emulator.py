"""The interface of every emulated device: bytes in, bytes out, on the bench's clock."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

Send = Callable[[bytes], None]
"""Takes the bytes that an emulator sends to the host; they leave at the emulator's present time."""


class Emulator(Protocol):
    """A device as the host sees it: at the byte level.

    An emulator never reads a clock. The bench tells it the time: before each byte and each due
    moment it calls :meth:`advance`. So the same bytes at the same times give the same answers.
    What the emulator sends goes out through the ``send`` of its constructor, only from within
    :meth:`feed` and :meth:`advance`.
    """

    @property
    def next_ns(self) -> int | None:
        """Bench time of the next thing that the device does by itself, None for nothing.

        The bench stops there and calls :meth:`advance`; it may also call it earlier.
        """
        ...

    def feed(self, data: bytes) -> None:
        """Bytes from the host arrive at the present time; any division into chunks may come."""
        ...

    def advance(self, to_ns: int) -> None:
        """Let time pass to ``to_ns`` (bench time in ns since power-on, never backwards).

        Everything that is due by then is done, in order.
        """
        ...
