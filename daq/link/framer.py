"""Splits received bytes into frames or lines, with a size limit and counts of dropped data."""

from __future__ import annotations

from collections.abc import Iterator

from valvefw import wire

MAX_FRAME_BYTES = 1024
MAX_LINE_BYTES = 256


class LineFramer:
    """Text lines of an instrument, such as MT-SICS with CR LF.

    Attributes:
        frames: lines returned.
        oversize: lines longer than ``max_bytes``, dropped up to their end.
        dropped_bytes: bytes in dropped lines.
    """

    def __init__(self, terminator: bytes = b"\r\n", max_bytes: int = MAX_LINE_BYTES) -> None:
        self._terminator = terminator
        self._max = max_bytes
        self._tail = b""
        self._skipping = False
        self.frames = 0
        self.oversize = 0
        self.dropped_bytes = 0

    def feed(self, data: bytes) -> list[bytes]:
        """Add received bytes; returns the completed lines without their terminator."""
        *whole, tail = (self._tail + data).split(self._terminator)
        lines: list[bytes] = []
        for line in whole:
            if self._skipping or len(line) > self._max:
                self.oversize += not self._skipping
                self._skipping = False
                self.dropped_bytes += len(line)
            elif (content := self._decode(line)) is not None:
                self.frames += 1
                lines.append(content)
        # The first bytes of a terminator may already be here: keep them even while skipping.
        keep = len(self._terminator) - 1
        if self._skipping or len(tail) > self._max + keep:
            self.oversize += not self._skipping
            self._skipping = True
            self.dropped_bytes += max(0, len(tail) - keep)
            tail = tail[max(0, len(tail) - keep) :]
        self._tail = tail
        return lines

    def texts(self, data: bytes) -> Iterator[tuple[str, str]]:
        """Lines of ASCII text, blank ones left out: ``(text, "")``, or ``("", what is wrong)``."""
        before = self.oversize
        lines = self.feed(data)
        for _ in range(self.oversize - before):
            yield "", "a line without an end"
        for raw in lines:
            line = raw.strip(b"\r\n\x00")
            if not line.strip():
                continue
            try:
                text = line.decode("ascii")
            except UnicodeDecodeError:
                yield "", repr(line)
                continue
            yield text, ""

    def _decode(self, line: bytes) -> bytes | None:
        """The content of a complete line; None if it is not valid."""
        return line

    @property
    def partial(self) -> bytes:
        """The bytes of an incomplete line."""
        return self._tail

    def discard(self) -> int:
        """Drop an incomplete line; returns its number of bytes."""
        lost = len(self._tail)
        self.dropped_bytes += lost
        self._tail = b""
        self._skipping = False
        return lost


class CobsFramer(LineFramer):
    """COBS frames with CRC-16 between zero bytes, see :mod:`valvefw.wire`.

    Invalid bytes damage only the frame they are in: decoding restarts at the next zero byte.

    Attributes:
        frames: valid frames returned, as payloads (type byte first, CRC removed).
        damaged: frames with an invalid COBS code or CRC.
        oversize: frames longer than ``max_bytes``.
        dropped_bytes: bytes in damaged and oversize frames.
    """

    def __init__(self, max_bytes: int = MAX_FRAME_BYTES) -> None:
        super().__init__(b"\x00", max_bytes)
        self.damaged = 0

    def _decode(self, line: bytes) -> bytes | None:
        payload = wire.decode_frame(line) if line else None
        if line and payload is None:
            self.damaged += 1
            self.dropped_bytes += len(line)
        return payload
