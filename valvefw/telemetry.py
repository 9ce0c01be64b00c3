"""Telemetry frames of the samples that the safety core recorded, and its black box."""

from valvefw.core import (
    BOOT_ID,
    BOX_AT,
    BOX_N,
    BOX_TICKS,
    RING,
    SAMPLE_BYTES,
    SENT,
    SETPOINT,
    TICKS,
    TIME_MASK,
    Core,
    gather,
)
from valvefw.wire import MAX_SAMPLES, ONE_BLOCK, seal


class Telemetry:
    """Frames of ``samples_per_frame`` samples; all samples of a frame have the same set-point."""

    def __init__(self, core: Core, boot_id: int) -> None:
        self._core = core
        self._state = core.state
        self._state[BOOT_ID] = self.boot_id = boot_id
        self.samples_per_frame = 10
        self.buffer = bytearray(ONE_BLOCK + 1)
        self._box = b""

    def full(self) -> bool:
        """Are there enough samples for a frame?"""
        s = self._state
        return (s[TICKS] - s[SENT]) & TIME_MASK >= self.samples_per_frame

    def frame(self, setpoint_x16: int) -> int:
        """Write the samples not yet sent into ``buffer`` as a frame; returns its length or 0."""
        core = self._core
        self._state[SETPOINT] = setpoint_x16
        size = gather(self._state, core.ring, core.times, self.buffer)
        return seal(self.buffer, size) if size else 0

    def keep(self) -> None:
        """Copy the samples before the first fault, unless they have been overwritten meanwhile."""
        s = self._state
        ring = self._core.ring
        n = min(s[BOX_N], RING - ((s[TICKS] - s[BOX_TICKS]) & TIME_MASK))
        end = s[BOX_AT] * SAMPLE_BYTES
        start = end - max(0, n) * SAMPLE_BYTES
        if start < 0:
            self._box = bytes(ring[start:]) + bytes(ring[:end])
        else:
            self._box = bytes(ring[start:end])

    def black_box(self) -> bytes:
        """The samples before the first fault, oldest first; empty without a fault."""
        return self._box if self._state[BOX_N] else b""


assert MAX_SAMPLES <= RING
