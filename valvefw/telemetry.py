"""Telemetry frames of the samples that the safety core recorded, and its black box."""

from valvefw.core import (
    BOOT_ID,
    BOX_AT,
    BOX_N,
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

    def black_box(self) -> bytes:
        """The samples before a first fault, oldest first; empty without a fault."""
        s = self._state
        box = self._core.box
        at = s[BOX_AT] * SAMPLE_BYTES
        n = s[BOX_N] * SAMPLE_BYTES
        first = bytes(box[at : min(at + n, RING * SAMPLE_BYTES)])
        return first + bytes(box[: n - len(first)])


assert MAX_SAMPLES <= RING
