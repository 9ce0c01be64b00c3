"""Measures the camera delay with the sync LED: frames against the LED's switching times.

The valve controller shows each bit of a 16-bit shift register for ``bit_ms`` (verb
``led sync <seed> <bit_ms>``). An exposure averages the LED over its duration, so the LED level
in a frame is a linear function of the lit share of the exposure. The delay is the time shift of
the pattern that fits the levels best.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from vision.gray import Box, to_gray

F64 = npt.NDArray[np.float64]


class SyncError(ValueError):
    """The LED levels do not contain the pattern."""


@dataclass(frozen=True)
class SyncDelay:
    """Frame time stamp minus device time of the start of the exposure.

    ``delay_s`` is the camera-minus-device delay with standard uncertainty ``u_delay_s``;
    ``contrast`` the LED's grey levels, ``noise`` the sd of the levels about the fit, ``frames``
    the number of frames used, ``repeated`` the number of frames equal to the one before,
    ``dropped`` the number of missing frames from the time stamps, ``ambiguity`` the misfit of
    the second best delay over that of the best (1: not distinguishable).
    """

    delay_s: float
    u_delay_s: float
    contrast: float
    noise: float
    frames: int
    dropped: int
    repeated: int
    ambiguity: float


def pattern(seed: int, bits: int) -> npt.NDArray[np.uint8]:
    """First ``bits`` bits of the LED pattern: bit k is the lowest bit after k steps from ``seed``.

    A 16-bit Galois register shifted right, mask 0xB400 (x^16 + x^14 + x^13 + x^11 + 1).
    """
    if not 0 < seed < 1 << 16:
        raise SyncError(f"the seed of the sync pattern is 1..65535, got {seed}")
    out = np.empty(bits, dtype=np.uint8)
    state = seed
    for k in range(bits):
        out[k] = state & 1
        state = (state >> 1) ^ 0xB400 if state & 1 else state >> 1
    return out


def led_level(frame: npt.NDArray[Any], patch: Box) -> float:
    """Mean grey level of the LED's patch (left, top, width, height)."""
    gray = to_gray(frame)
    left, top, width, height = patch
    part = gray[max(0, top) : top + height, max(0, left) : left + width]
    if part.size == 0:
        raise SyncError(f"the LED's patch {patch} lies outside the frame {gray.shape[::-1]}")
    return float(part.mean())


def patch_row_shift(patch: Box, height: int, readout_s: float) -> float:
    """Delay of the exposure of the patch's middle row relative to the first row, s."""
    return readout_s * (patch[1] + patch[3] / 2) / height


def count_dropped(frame_s: F64, period_s: float) -> int:
    """Number of missing frames in the gaps between the time stamps."""
    steps = np.rint(np.diff(frame_s) / period_s)
    return int(np.sum(np.maximum(steps - 1, 0)))


def find_delay(  # noqa: PLR0913 - properties of the camera, by keyword
    levels: F64,
    frame_s: F64,
    start_s: float,
    seed: int,
    bit_ms: float,
    *,
    exposure_s: float,
    row_shift_s: float = 0.0,
    longest_s: float = 0.2,
    period_s: float | None = None,
    repeated: npt.NDArray[np.bool_] | None = None,
) -> SyncDelay:
    """Find the delay between a frame's time stamp and its exposure.

    Args:
        levels: LED level of each frame, grey levels.
        frame_s: time stamps of the frames on the device clock (after the clock fit).
        start_s: device time of the start of bit 0.
        seed, bit_ms: the pattern.
        exposure_s: exposure time of a row; row_shift_s: see ``patch_row_shift`` (0: global
            shutter).
        longest_s: delays from -longest_s/10 to longest_s are tried.
        period_s: frame period for the count of dropped frames; None takes the median step.
        repeated: True where a frame repeats the one before; such frames are not used.

    Raises:
        SyncError: fewer than 20 frames, or the pattern is not in the levels.
    """
    levels = np.asarray(levels, dtype=np.float64)
    frame_s = np.asarray(frame_s, dtype=np.float64)
    stale = np.zeros(len(levels), dtype=bool) if repeated is None else np.asarray(repeated)
    use = np.isfinite(levels) & ~stale
    bit_s = bit_ms / 1000.0
    # use only frames that the pattern covers for every possible delay
    use &= frame_s - longest_s >= start_s
    if int(use.sum()) < 20:
        raise SyncError(f"{int(use.sum())} frames show the sync pattern; at least 20 are needed")
    value, stamp = levels[use], frame_s[use]
    bits = math.ceil((stamp.max() + longest_s - start_s + exposure_s) / bit_s) + 4
    lit = np.concatenate([[0.0], np.cumsum(pattern(seed, bits)) * bit_s])
    knots = np.arange(bits + 1) * bit_s

    def share(delay: float) -> F64:
        begin = stamp - delay + row_shift_s - start_s
        end = np.interp(begin + exposure_s, knots, lit) - np.interp(begin, knots, lit)
        return np.asarray(end / exposure_s)

    centred = value - value.mean()

    def misfit(delay: float) -> float:
        s = share(delay)
        s = s - s.mean()
        power = float(s @ s)
        gain = float(s @ centred) / power if power > 0 else 0.0
        return float(centred @ centred) - gain * abs(gain) * power

    tried = np.arange(-0.1 * longest_s, longest_s, min(exposure_s, bit_s) / 8)
    scores = np.array([misfit(float(d)) for d in tried])
    best = int(np.argmin(scores))
    apart = np.abs(tried - tried[best]) > max(bit_s, exposure_s)
    second = float(scores[apart].min()) if apart.any() else math.inf
    # if no exposure contains a change of the LED, a range of delays fits equally well
    alike = scores <= scores[best] + 0.02 * float(centred @ centred)
    first, last = best, best
    while first > 0 and alike[first - 1]:
        first -= 1
    while last < len(tried) - 1 and alike[last + 1]:
        last += 1
    low, high = tried[max(0, first - 2)], tried[min(len(tried) - 1, last + 2)]
    grid = np.linspace(low, high, 801)
    fine = np.array([misfit(float(d)) for d in grid])
    spread2 = float(fine.min()) / max(1, len(value) - 3)
    flat = grid[fine <= fine.min() + spread2 + 1e-9]
    delay = 0.5 * (float(flat.min()) + float(flat.max()))
    s = share(delay)
    design = np.stack([np.ones_like(s), s], axis=1)
    fit, *_ = np.linalg.lstsq(design, value, rcond=None)
    rest = value - design @ fit
    noise = math.sqrt(float(rest @ rest) / max(1, len(value) - 3))
    contrast = float(fit[1])
    ambiguity = second / max(float(fine.min()), 1e-12)
    if contrast <= 0 or float(fine.min()) > 0.5 * float(centred @ centred) or ambiguity < 1.3:
        raise SyncError(
            "the LED's pattern does not show in the frames: check that the LED is inside its "
            "patch, lit by 'led sync', and not over-exposed"
        )
    # only exposures that contain a change of the LED have information on the delay
    h = min(exposure_s, bit_s) / 50
    rate = (share(delay + h) - share(delay - h)) / (2 * h) * contrast
    rate = rate - rate.mean()
    power = float(rate @ rate)
    u = math.sqrt((noise**2 + 1e-6) / power) if power > 0 else math.inf
    u = min(u, (float(flat.max()) - float(flat.min())) / math.sqrt(12) + 0.1 * exposure_s)
    u = max(u, (float(flat.max()) - float(flat.min())) / math.sqrt(12))
    u = math.hypot(u, 0.01 * exposure_s)  # rows of the patch are exposed at different times
    step = float(np.median(np.diff(frame_s))) if period_s is None else period_s
    return SyncDelay(
        delay,
        u,
        contrast,
        noise,
        len(value),
        count_dropped(frame_s, step),
        int(stale.sum()),
        ambiguity,
    )
