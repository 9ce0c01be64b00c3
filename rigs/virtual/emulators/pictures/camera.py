"""Renders what the bench's camera would see: two dark marks on a lighter ground, and the LED.

The reference mark stands near the right border of the frame with its facing edge at
column 630, the marker to its left, so that a run can be measured both by the edge method
and, with the thesis's own region (10, 300, 500, 70), by the macro.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from plant.arrays import Array


@dataclass(frozen=True)
class CameraModel:
    """Optics, scene and sensor of the virtual camera; lengths in the frame are in pixels.

    ``mark_rows`` bound both marks; ``light_x`` and ``light_y`` are the relative change of
    the light across the frame; ``noise`` is the sensor noise in grey levels (sd);
    ``readout_s`` is the time between the first and the last row (0: global shutter);
    ``led`` is centre x, centre y and radius of the sync LED, None for none.
    """

    width: int = 640
    height: int = 480
    offset_mm: float = 40.0
    mm_per_pixel: float = 0.11
    reference_x: float = 630.0
    marker_width: float = 90.0
    mark_rows: tuple[float, float] = (60.0, 420.0)
    ground: float = 190.0
    mark: float = 45.0
    light_x: float = 0.12
    light_y: float = 0.06
    blur_px: float = 1.0
    noise: float = 2.0
    tilt_deg: float = 0.0
    exposure_s: float = 0.004
    readout_s: float = 0.0
    led: tuple[float, float, float] | None = (60.0, 30.0, 9.0)
    led_light: float = 60.0

    @property
    def led_patch(self) -> tuple[int, int, int, int] | None:
        """Left, top, width, height of the patch that holds the LED and its blur."""
        if self.led is None:
            return None
        x, y, radius = self.led
        reach = radius + 4.0 * self.blur_px + 1.0
        left, top = max(0, int(x - reach)), max(0, int(y - reach))
        right = min(self.width, int(np.ceil(x + reach)))
        bottom = min(self.height, int(np.ceil(y + reach)))
        return left, top, right - left, bottom - top


def render(
    length_mm: float,
    rng: np.random.Generator,
    model: CameraModel | None = None,
    *,
    led: float | Array = 0.0,
    rate_mm_s: float = 0.0,
    exposure_gain: float = 1.0,
) -> npt.NDArray[np.uint8]:
    """One frame of the bench, grey, shape (height, width).

    Args:
        length_mm: muscle length at the middle of the first row's exposure.
        rng: source of the sensor noise; the same state gives the same frame to the bit.
        model: the camera; the default is the virtual bench's.
        led: share of the exposure for which the LED was lit, one number or one per row.
        rate_mm_s: muscle speed, for motion blur and the skew of a rolling shutter.
        exposure_gain: factor on all light (an exposure change).
    """
    m = model or CameraModel()
    rows: Array = np.arange(m.height, dtype=np.float64) + 0.5
    length = length_mm + rate_mm_s * m.readout_s * (rows - 0.5) / m.height
    gap = (length - m.offset_mm) / m.mm_per_pixel
    slope = math.tan(math.radians(m.tilt_deg))
    reference = m.reference_x + slope * (rows - m.height / 2)
    marker = reference - gap / math.cos(math.radians(m.tilt_deg))
    smear = abs(rate_mm_s) * m.exposure_s / m.mm_per_pixel
    cover = _cover(m, reference, marker, smear)
    ground, darker = _scene(m)
    frame: npt.NDArray[np.float32] = ground - darker * cover
    if m.led is not None and np.any(led):
        left, upper, width, height = m.led_patch or (0, 0, 0, 0)
        lit = np.broadcast_to(np.asarray(led, dtype=np.float64), (m.height,))
        part = slice(upper, upper + height), slice(left, left + width)
        frame[part] += (m.led_light * _led_spot(m) * lit[part[0], None]).astype(np.float32)
    if exposure_gain != 1.0:
        frame = frame * np.float32(exposure_gain)
    from rigs.virtual.emulators.pictures.pixels import digitise  # numba stays out of start-up

    return digitise(frame, m.noise, rng)


def led_exposure(
    toggles_s: Sequence[float] | Array,
    start_s: float,
    model: CameraModel | None = None,
    *,
    lit_first: bool = False,
) -> Array:
    """Share of each row's exposure for which the LED was lit, shape (height,).

    Args:
        toggles_s: moments at which the LED changed, ascending; before the first of them it
            was ``lit_first``.
        start_s: when the exposure of the first row began, on the same clock.
        model: gives exposure, row readout and height.
    """
    m = model or CameraModel()
    times = np.asarray(toggles_s, dtype=np.float64)
    begin = start_s + m.readout_s * np.arange(m.height) / m.height
    end = begin + m.exposure_s
    if times.size == 0:
        return np.full(m.height, float(lit_first))
    lit = (np.arange(times.size) % 2 == 0) != lit_first  # state after each toggle
    spans = np.diff(times)
    total = np.concatenate([[0.0], np.cumsum(spans * lit[:-1])])

    def lit_until(t: Array) -> Array:
        index = np.searchsorted(times, t, side="right") - 1
        inside = np.clip(index, 0, None)
        after = total[inside] + lit[inside] * (t - times[inside])
        return np.asarray(np.where(index < 0, float(lit_first) * (t - times[0]), after))

    share: Array = (lit_until(end) - lit_until(begin)) / m.exposure_s
    return np.asarray(np.clip(share, 0.0, 1.0))


def _step(d: Array, blur: float, smear: float) -> Array:
    """Light of a unit step at 0, seen at ``d`` by a unit pixel through blur and motion."""
    from scipy.special import erf

    sigma = max(blur, 1e-3)

    def ramp(t: Array) -> Array:  # integral of the normal distribution function
        z = t / sigma
        value: Array = t * 0.5 * (1 + erf(z / np.sqrt(2))) + sigma * np.exp(-0.5 * z * z) / np.sqrt(
            2 * np.pi
        )
        return value

    if smear < 1e-6:
        return ramp(d + 0.5) - ramp(d - 0.5)
    count = max(3, int(np.ceil(8 * smear)))
    offsets = ((np.arange(count) + 0.5) / count - 0.5) * smear
    return np.asarray(np.mean([ramp(d + o + 0.5) - ramp(d + o - 0.5) for o in offsets], axis=0))


def _cover(
    m: CameraModel, reference: Array, marker: Array, smear: float
) -> npt.NDArray[np.float32]:
    """Share of each pixel that the marks cover sideways; (1, width) where all rows agree."""
    same = bool(np.all(reference == reference[0]) and np.all(marker == marker[0]))
    rows = 1 if same else m.height
    cover = np.zeros((rows, m.width), dtype=np.float32)
    for edge, smear_px, sign in (
        (reference, 0.0, 1.0),
        (marker - m.marker_width, smear, 1.0),
        (marker, smear, -1.0),
    ):
        reach = 6.0 * m.blur_px + 0.5 * smear_px + 2.0
        lo = max(0, min(m.width, int(edge.min() - reach)))
        hi = max(lo, min(m.width, int(np.ceil(edge.max() + reach))))
        columns = np.arange(lo, hi) + 0.5
        if hi > lo:
            d = columns[None, :] - edge[:rows, None]
            cover[:, lo:hi] += (sign * _step(d, m.blur_px, smear_px)).astype(np.float32)
        cover[:, hi:] += np.float32(sign)
    return cover


@lru_cache(maxsize=16)
def _scene(m: CameraModel) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """Ground light, and how much darker a mark is, for each pixel."""
    x = (np.arange(m.width) + 0.5) / m.width - 0.5
    y = (np.arange(m.height) + 0.5) / m.height - 0.5
    light = 1.0 + m.light_x * x[None, :] + m.light_y * y[:, None]
    rows: Array = np.arange(m.height, dtype=np.float64) + 0.5
    top, bottom = m.mark_rows
    height = _step(rows - top, m.blur_px, 0.0) - _step(rows - bottom, m.blur_px, 0.0)
    ground = (light * m.ground).astype(np.float32)
    return ground, (light * (m.ground - m.mark) * height[:, None]).astype(np.float32)


@lru_cache(maxsize=16)
def _led_spot(m: CameraModel) -> Array:
    left, top, width, height = m.led_patch or (0, 0, 0, 0)
    x0, y0, radius = m.led or (0.0, 0.0, 1.0)
    x = np.arange(left, left + width) + 0.5 - x0
    y = np.arange(top, top + height) + 0.5 - y0
    r = np.asarray(np.hypot(x[None, :], y[:, None]), dtype=np.float64)
    return 1.0 - _step(r - radius, m.blur_px, 0.0)
