"""Joins telemetry frames to batches of columns; handles overflow, gaps, duplicates and reboots."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from daq.link.clockfit import DeviceTime
from daq.link.codec import SAMPLE_DTYPE, telemetry_head
from valvefw import wire

VALVE_COLUMNS = {
    "seq": "int64",
    "device_us": "int64",
    "host_ns": "int64",
    "boot": "uint16",
    "counts": "uint16",
    "flags": "uint8",
    "inlet_u5": "uint8",
    "vent_u5": "uint8",
    "setpoint_x16": "uint16",
}
VALVE_UNITS = {
    "device_us": "us",
    "host_ns": "ns",
    "counts": "counts",
    "inlet_u5": "5 us",
    "vent_u5": "5 us",
    "setpoint_x16": "counts/16",
}
BATCH_SAMPLES = 50
_WRAP = 1 << 32
_HALF = 1 << 31

Batch = dict[str, npt.NDArray[Any]]


@dataclass(frozen=True)
class Gap:
    """``missing`` lost samples, the first with number ``seq``."""

    seq: int
    missing: int


class _Held(NamedTuple):
    """A frame that waits for its batch: header values and undecoded samples."""

    seq: int
    device_us: int
    host_ns: int
    boot: int
    setpoint_x16: int
    n: int
    samples: bytes


class TelemetryStream:
    """Joins telemetry frames to batches.

    ``seq`` and ``device_us`` continue beyond their 32 bits. After a reboot ``seq`` continues,
    so that it identifies a sample within the whole run; ``device_us`` restarts with another
    ``boot``. A batch ends with the frame that fills it, independent of arrival times: equal
    frames give equal batches.

    Args:
        on_batch: called with a dict of arrays, columns as ``VALVE_COLUMNS``.
        on_gap: called with each :class:`Gap`.
        on_boot: called with ``(old, new)`` boot id after a restart of the device.
        batch_samples: number of samples per batch (50 = 50 ms at 1 kHz).
        device_time: shared with the clock fit, so that both count overflows alike.

    Attributes:
        samples, gaps, missing, duplicates, reboots, unknown_dt: counts (``gaps`` counts places,
            ``missing`` samples).
        next_seq: expected number of the next sample; None before the first.
        on_ahead: called with the columns of each frame before its batch is full, if not None.
    """

    def __init__(
        self,
        on_batch: Callable[[Batch], object],
        *,
        on_gap: Callable[[Gap], object] | None = None,
        on_boot: Callable[[int, int], object] | None = None,
        batch_samples: int = BATCH_SAMPLES,
        device_time: DeviceTime | None = None,
    ) -> None:
        self._on_batch = on_batch
        self.on_ahead: Callable[[Batch], object] | None = None
        self._on_gap = on_gap
        self._on_boot = on_boot
        self._batch_samples = batch_samples
        self.device_time = device_time or DeviceTime()
        self._held: list[_Held] = []
        self._held_samples = 0
        self._seq_shift = 0
        self.next_seq: int | None = None
        self.boot: int | None = None
        self.samples = 0
        self.gaps = 0
        self.missing = 0
        self.duplicates = 0
        self.reboots = 0
        self.unknown_dt = 0

    def feed(self, payload: bytes, host_ns: int) -> None:
        """Add one telemetry payload, received at ``host_ns``.

        Raises:
            CodecError: the payload is not telemetry.
        """
        boot, setpoint_x16, seq0, t0_us, n = telemetry_head(payload)
        if n == 0:
            return
        samples = payload[wire.TELEMETRY_HEADER_SIZE :]
        if boot != self.boot:
            self._rebooted(boot, seq0)
        expected = self.next_seq
        seq = seq0 + self._seq_shift
        if expected is None:
            self.next_seq = expected = seq
        if seq != expected:
            seq = expected + (seq - expected + _HALF) % _WRAP - _HALF
            self._seq_shift = seq - seq0
            if seq < expected:
                duplicate = min(n, expected - seq)
                self.duplicates += duplicate
                if duplicate == n:
                    return
                first = np.frombuffer(samples, SAMPLE_DTYPE, count=duplicate + 1)
                t0_us = (t0_us + int(first["dt_us"][1:].sum(dtype=np.int64))) % _WRAP
                samples = samples[duplicate * wire.SAMPLE_SIZE :]
                n -= duplicate
                seq = expected
            elif seq > expected:
                gap = Gap(expected, seq - expected)
                self.gaps += 1
                self.missing += gap.missing
                if self._on_gap is not None:
                    self._on_gap(gap)
        device_us = self.device_time.unwrap(t0_us, host_ns)
        held = _Held(seq, device_us, host_ns, boot, setpoint_x16, n, samples)
        self._held.append(held)
        self._held_samples += n
        self.next_seq = seq + n
        if self.on_ahead is not None:
            self.on_ahead(_columns([held])[0])
        if self._held_samples >= self._batch_samples:
            self.flush()

    def flush(self) -> None:
        """Pass the incomplete batch on, at the end of a run."""
        held, self._held = self._held, []
        if not held:
            return
        self._held_samples = 0
        batch, unknown = _columns(held)
        self.unknown_dt += unknown
        self.samples += len(batch["seq"])
        self._on_batch(batch)

    def counters(self) -> dict[str, int]:
        """The counts for final.json."""
        names = ("samples", "gaps", "missing", "duplicates", "reboots", "unknown_dt")
        return {name: getattr(self, name) for name in names}

    def _rebooted(self, boot: int, seq0: int) -> None:
        old, self.boot = self.boot, boot
        if old is None:
            return
        self.flush()
        self.reboots += 1
        self.device_time.reset()
        assert self.next_seq is not None
        self._seq_shift = self.next_seq - seq0
        if self._on_boot is not None:
            self._on_boot(old, boot)


def _columns(held: list[_Held]) -> tuple[Batch, int]:
    """Frames as columns, and the number of samples without a known time step."""
    raw = np.frombuffer(b"".join([h.samples for h in held]), SAMPLE_DTYPE)
    counts = np.array([h.n for h in held])
    first = np.cumsum(counts) - counts
    dt = raw["dt_us"].astype(np.int64)
    dt[first] = 0  # t0_us is the time of the first sample of each frame
    unknown = int(np.count_nonzero(dt == wire.DT_UNKNOWN))
    elapsed = np.cumsum(dt)
    start_us = np.array([h.device_us for h in held], np.int64) - elapsed[first]
    offset = np.array([h.seq for h in held], np.int64) - first
    repeat = np.repeat
    batch: Batch = {
        "seq": repeat(offset, counts) + np.arange(len(raw)),
        "device_us": repeat(start_us, counts) + elapsed,
        "host_ns": repeat(np.array([h.host_ns for h in held], np.int64), counts),
        "boot": repeat(np.array([h.boot for h in held], np.uint16), counts),
        "counts": raw["counts"].copy(),
        "flags": raw["flags"].copy(),
        "inlet_u5": raw["inlet_u5"].copy(),
        "vent_u5": raw["vent_u5"].copy(),
        "setpoint_x16": repeat(np.array([h.setpoint_x16 for h in held], np.uint16), counts),
    }
    return batch, unknown
