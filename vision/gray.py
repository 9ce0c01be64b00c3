"""Converts frames to grey arrays and checks regions against the frame."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

Box = tuple[int, int, int, int]
LEAST_WIDTH, LEAST_HEIGHT = 24, 8
MOST_SIDE = 1 << 14
"""Pixels; time and memory of the edge search grow with the square of the height."""


class FrameError(ValueError):
    """The array is not a camera frame."""


class RegionError(ValueError):
    """The region does not fit the frame."""


def to_gray(frame: npt.NDArray[Any]) -> npt.NDArray[np.uint8] | npt.NDArray[np.float32]:
    """Convert a frame to grey levels 0..255, shape (height, width), contiguous.

    8-bit frames stay unchanged. 16-bit frames are divided by 257 and become float32. Colour
    (RGB or RGBA) is weighted 0.299, 0.587, 0.114 (ITU-R BT.601).

    Raises:
        FrameError: wrong number of axes, no pixels, or an unsupported type.
    """
    array = np.asarray(frame)
    if array.ndim == 3 and array.shape[2] in (1, 2):  # grey, grey with alpha
        array = array[:, :, 0]
    if array.ndim not in (2, 3) or (array.ndim == 3 and array.shape[2] not in (3, 4)):
        raise FrameError(
            f"a frame has the shape (height, width) or (height, width, 3 or 4), got {array.shape}"
        )
    if array.size == 0:
        raise FrameError(f"the frame has no pixels (shape {array.shape})")
    if array.dtype == np.bool_:
        array = array.astype(np.uint8) * np.uint8(255)
    if array.dtype not in (np.uint8, np.uint16) and not np.issubdtype(array.dtype, np.floating):
        raise FrameError(f"a frame holds 8-bit or 16-bit grey levels, got {array.dtype}")
    if array.dtype == np.uint8 and array.ndim == 2:
        return np.ascontiguousarray(array)
    with np.errstate(over="ignore", invalid="ignore"):  # what is too large is refused below
        levels = array.astype(np.float32, copy=False)
        if array.dtype == np.uint16:
            levels /= np.float32(257.0)
        if levels.ndim == 3:
            levels = levels[:, :, :3] @ np.array([0.299, 0.587, 0.114], dtype=np.float32)
    if not np.isfinite(levels).all():
        raise FrameError("the frame contains non-finite numbers")
    return np.ascontiguousarray(levels)


def clip_region(region: Box | None, width: int, height: int) -> Box:
    """The part of ``region`` (left, top, width, height) inside a frame of this size.

    Raises:
        RegionError: the part is empty, too small for two edges, or too large.
    """
    if region is None:
        box = (0, 0, width, height)
    else:
        left, top = max(0, region[0]), max(0, region[1])
        right = min(width, region[0] + region[2])
        bottom = min(height, region[1] + region[3])
        if right <= left or bottom <= top:
            raise RegionError(
                f"region {tuple(region)} (left, top, width, height) lies outside the frame of "
                f"{width} x {height} pixels"
            )
        box = (left, top, right - left, bottom - top)
    if box[2] < LEAST_WIDTH or box[3] < LEAST_HEIGHT:
        raise RegionError(
            f"the region holds {box[2]} x {box[3]} pixels of the frame of {width} x {height}; "
            f"at least {LEAST_WIDTH} x {LEAST_HEIGHT} are needed to find two edges"
        )
    if max(box[2:]) > MOST_SIDE:
        raise RegionError(
            f"the region holds {box[2]} x {box[3]} pixels; the limit is {MOST_SIDE} per side"
        )
    return box
