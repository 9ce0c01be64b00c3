"""Switching times of the valves from fast blocks: what the thesis read off an oscilloscope.

A block holds the samples around one pulse (``capture``, docs/reference/wire-format.md). The air
needs time from the valve to a sensor down the line; times are corrected for it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from daq.errors import DeviceError

AIR_M_S = 65.0
"""Speed of the air down the line (thesis 5.12)."""
LINE_MM = 62.0
LEVEL = 0.25
"""An edge is where the signal passes this share of its largest rise ..."""
NOISES = 6.0
"""... or so many standard deviations of its noise, if that is more."""


def air_delay_ms(line_mm: float = LINE_MM, air_m_s: float = AIR_M_S) -> float:
    """Time in ms that the air needs from the valve to a sensor ``line_mm`` down the line."""
    return line_mm / air_m_s


@dataclass(frozen=True)
class Block:
    """Fast samples around one pulse.

    ``counts`` has shape (n,), one every ``period_us`` from ``lead_us`` before the command on; the
    command lasted ``width_us``.
    """

    valve: str
    width_us: int
    lead_us: int
    period_us: int
    counts: npt.NDArray[np.float64]


@dataclass(frozen=True)
class SwitchingTimes:
    """Delays in ms from a command's edges to the valve's, the line's delay taken off."""

    on_ms: float
    off_ms: float


def switching_times(block: Block, delay_ms: float | None = None) -> SwitchingTimes:
    """When the valve opened and shut, from a sensor that sees flow and sees none.

    Args:
        block: samples of the second sensor.
        delay_ms: what the line takes; by default that of 62 mm at 65 m/s.

    Raises:
        DeviceError: no flow is to be seen, or it does not end within the block.
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
            "a valve that leaks, or a command too long for the block",
        )
    up = first - (y[first] - level) / (y[first] - y[first - 1])
    down = last + (y[last] - level) / (y[last] - y[last + 1])
    edge_ms = block.period_us * 1e-3
    command_ms = block.lead_us * 1e-3 + delay_ms
    return SwitchingTimes(
        on_ms=float(up) * edge_ms - command_ms,
        off_ms=float(down) * edge_ms - command_ms - block.width_us * 1e-3,
    )
