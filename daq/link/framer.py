"""Bytes in, whole frames out: pure, bounded, and counting what it throws away."""

from __future__ import annotations

from valvefw import wire

MAX_FRAME_BYTES = 1024
MAX_LINE_BYTES = 256


class CobsFramer:
    """COBS frames with CRC-16 between zero bytes, as :mod:`valvefw.wire` writes them.

    Garbage costs the frame it falls into and no other: the next zero byte starts anew.

    Attributes:
        frames: sound frames handed out.
        damaged: frames whose COBS code or CRC did not hold.
        oversize: frames longer than ``max_bytes``.
        dropped_bytes: bytes in damaged and oversize frames.
    """

    def __init__(self, max_bytes: int = MAX_FRAME_BYTES) -> None:
        self._max = max_bytes
        self._tail = b""
        self._skipping = False
        self.frames = 0
        self.damaged = 0
        self.oversize = 0
        self.dropped_bytes = 0

    def feed(self, data: bytes) -> list[bytes]:
        """Payloads (type byte first, CRC removed) completed by ``data``."""
        *whole, tail = (self._tail + data).split(b"\x00") if self._tail else data.split(b"\x00")
        payloads: list[bytes] = []
        for frame in whole:
            if self._skipping:
                self._skipping = False
                self.dropped_bytes += len(frame)
            elif frame:
                self._open(frame, payloads)
        if self._skipping or len(tail) > self._max:
            if not self._skipping:
                self.oversize += 1
                self._skipping = True
            self.dropped_bytes += len(tail)
            tail = b""
        self._tail = tail
        return payloads

    @property
    def partial(self) -> bytes:
        """What has come of a frame whose end has not."""
        return self._tail

    def _open(self, frame: bytes, payloads: list[bytes]) -> None:
        if len(frame) > self._max:
            self.oversize += 1
            self.dropped_bytes += len(frame)
            return
        payload = wire.decode_frame(frame)
        if payload is None:
            self.damaged += 1
            self.dropped_bytes += len(frame)
            return
        self.frames += 1
        payloads.append(payload)


class LineFramer:
    """Text lines of a third-party device, such as MT-SICS, ended by CR LF.

    Attributes:
        frames: lines handed out.
        oversize: lines longer than ``max_bytes``, thrown away up to their end.
        dropped_bytes: bytes in them.
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
        """Lines completed by ``data``, without their terminator."""
        *whole, tail = (self._tail + data).split(self._terminator)
        lines: list[bytes] = []
        for line in whole:
            if self._skipping or len(line) > self._max:
                self.oversize += not self._skipping
                self._skipping = False
                self.dropped_bytes += len(line)
                continue
            self.frames += 1
            lines.append(line)
        # A terminator may be cut in two, so its first bytes are kept even while skipping.
        keep = len(self._terminator) - 1
        if self._skipping or len(tail) > self._max + keep:
            if not self._skipping:
                self.oversize += 1
                self._skipping = True
            self.dropped_bytes += max(0, len(tail) - keep)
            tail = tail[len(tail) - keep :] if keep and len(tail) > keep else tail * (keep > 0)
        self._tail = tail
        return lines

    @property
    def partial(self) -> bytes:
        """What has come of a line whose end has not."""
        return self._tail

    def discard(self) -> int:
        """Throw away the beginning of a line whose end will not come; how many bytes it had."""
        lost = len(self._tail)
        self.dropped_bytes += lost
        self._tail = b""
        self._skipping = False
        return lost
