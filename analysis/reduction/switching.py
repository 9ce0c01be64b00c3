"""Switching times of the valves from fast blocks, as the thesis read them from an oscilloscope.

A block holds the samples around one pulse (``capture``, docs/reference/wire-format.md). The times
are corrected for the propagation delay from the valve to the sensor.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from daq.errors import DeviceError

AIR_M_S = 65.0
"""Speed of the air in the line (thesis 5.12)."""
LINE_MM = 62.0
LEVEL = 0.25
"""Flow is detected where the signal is above this fraction of its largest rise ..."""
NOISES = 6.0
"""... or this many standard deviations of its noise, whichever is larger."""
PLATEAU = 6
"""The edge itself is at half of the median of this many samples beside it: midway between two
samples of a sharp edge, which is its mean position. At a quarter the closing would be late and the
opening early by a quarter of a sample period; half of the largest rise would be wrong where the
flow falls during the pulse."""


def air_delay_ms(line_mm: float = LINE_MM, air_m_s: float = AIR_M_S) -> float:
    """Propagation delay in ms from the valve to a sensor at ``line_mm`` along the line."""
    return line_mm / air_m_s


@dataclass(frozen=True)
class Block:
    """Fast samples around one pulse.

    ``counts`` has shape (n,), with one sample every ``period_us``. The first sample is
    ``lead_us`` before the command starts. The command lasts ``width_us``.
    """

    valve: str
    width_us: int
    lead_us: int
    period_us: int
    counts: npt.NDArray[np.float64]


@dataclass(frozen=True)
class SwitchingTimes:
    """Delays in ms from the edges of the command to those of the valve, line delay subtracted."""

    on_ms: float
    off_ms: float


def switching_times(block: Block, delay_ms: float | None = None) -> SwitchingTimes:
    """Opening and closing delay of the valve, from a sensor that detects the flow.

    Args:
        block: samples of the second sensor.
        delay_ms: propagation delay of the line; the default is that of 62 mm at 65 m/s.

    Raises:
        DeviceError: no flow is detected, or it does not end within the block.
    """
    delay_ms = air_delay_ms() if delay_ms is None else delay_ms
    y = block.counts
    before = y[: block.lead_us // block.period_us]
    base, noise = float(np.median(before)), float(before.std())
    height = float(y.max()) - base
    if height < 2.0 * NOISES * noise:
        raise DeviceError(
            f"{block.valve} valve",
            f"no flow in the block: largest rise {height:.0f} counts, noise {noise:.0f}",
            "check supply, sensor and the length of the command",
        )
    level = base + max(LEVEL * height, NOISES * noise)
    above = np.flatnonzero(y > level)
    first, last = int(above[0]), int(above[-1])
    if first == 0 or last == len(y) - 1:
        raise DeviceError(
            f"{block.valve} valve",
            f"flow {'before the command' if first == 0 else 'to the end of the block'}",
            "the valve leaks, or the command is too long for the block",
        )
    up = _half_rise(y[: last + 1], first, base)
    down = len(y) - 1 - _half_rise(y[first:][::-1], len(y) - 1 - last, base)
    edge_ms = block.period_us * 1e-3
    command_ms = block.lead_us * 1e-3 + delay_ms
    return SwitchingTimes(
        on_ms=float(up) * edge_ms - command_ms,
        off_ms=float(down) * edge_ms - command_ms - block.width_us * 1e-3,
    )


def _half_rise(y: npt.NDArray[np.float64], first: int, base: float) -> float:
    """Where a rise passes half of the level that follows it, in samples, interpolated.

    Args:
        y: samples; their rise begins at or before ``first``, and it ends with the last of them.
        first: the first sample in which flow was detected.
        base: signal without flow.
    """
    half = (base + float(np.median(y[first + 1 : first + 1 + PLATEAU]))) / 2.0
    if first + 1 >= len(y) or half <= base:
        half = (base + float(y[first])) / 2.0
    at = first
    while at + 1 < len(y) and y[at] <= half:
        at += 1
    while at > 1 and y[at - 1] > half:
        at -= 1
    step = float(y[at] - y[at - 1])
    return at - min(max((float(y[at]) - half) / step, 0.0), 1.0) if step > 0 else float(at)
