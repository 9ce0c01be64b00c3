"""Collects samples into telemetry frames; the same ring buffer is the black box of 64 samples."""

import struct

from valvefw.wire import (
    DT_UNKNOWN,
    MAX_SAMPLES,
    SAMPLE,
    SAMPLE_SIZE,
    TELEMETRY,
    TELEMETRY_HEADER,
    encode_frame,
)

RING = 64
_RING_BYTES = RING * SAMPLE_SIZE
_pack_into = struct.pack_into


class Telemetry:
    """Collects samples; all samples of a frame have the same set-point."""

    def __init__(self, boot_id: int) -> None:
        self.boot_id = boot_id
        self.samples_per_frame = 10
        self.seq = 0
        self._ring = bytearray(_RING_BYTES)
        self._at = 0
        self._held = 0
        self._t0_us = 0

    def add(
        self, now_us: int, dt_us: int, counts: int, flags: int, inlet_u5: int, vent_u5: int
    ) -> bool:
        """Add one sample; True when a frame is full."""
        at = self._at
        _pack_into(
            SAMPLE,
            self._ring,
            at,
            dt_us if dt_us < DT_UNKNOWN and self.seq else DT_UNKNOWN,
            counts,
            flags,
            inlet_u5,
            vent_u5,
        )
        at += SAMPLE_SIZE
        self._at = at if at < _RING_BYTES else 0
        held = self._held
        if not held:
            self._t0_us = now_us
        self._held = held + 1
        self.seq = (self.seq + 1) & 0xFFFFFFFF
        return held + 1 >= self.samples_per_frame

    def frame(self, setpoint_x16: int) -> bytes:
        """The collected samples as an encoded frame; empty if there are none."""
        n = self._held
        if not n:
            return b""
        self._held = 0
        header = struct.pack(
            TELEMETRY_HEADER,
            TELEMETRY,
            self.boot_id,
            setpoint_x16,
            (self.seq - n) & 0xFFFFFFFF,
            self._t0_us & 0xFFFFFFFF,
            n,
        )
        return encode_frame(header + self._last(n))

    def _last(self, n: int) -> bytes:
        start = self._at - n * SAMPLE_SIZE
        if start >= 0:
            return bytes(self._ring[start : self._at])
        return bytes(self._ring[start + _RING_BYTES :]) + bytes(self._ring[: self._at])

    def black_box(self) -> bytes:
        """The last 64 samples (fewer after boot), oldest first."""
        return self._last(min(self.seq, RING))


assert MAX_SAMPLES <= RING
