"""Frames as grey arrays, and regions checked against them."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

Box = tuple[int, int, int, int]
LEAST_WIDTH, LEAST_HEIGHT = 24, 8
MOST_SIDE = 1 << 14
"""Pixels; the search for edges takes time and memory with the square of the height."""


class FrameError(ValueError):
    """An array that cannot be a camera frame."""


class RegionError(ValueError):
    """A region that does not fit the frame."""


def to_gray(frame: npt.NDArray[Any]) -> npt.NDArray[np.uint8] | npt.NDArray[np.float32]:
    """Grey levels 0..255, shape (height, width), contiguous.

    Eight bits stay as they are; 16 bits are divided by 257 and keep their resolution as
    float32; colour (RGB or RGBA) is weighted 0.299, 0.587, 0.114 (ITU-R BT.601).

    Raises:
        FrameError: not two or three axes, no pixels, or another type of number.
    """
    array = np.asarray(frame)
    if array.ndim == 3 and array.shape[2] in (1, 2):  # grey, grey with opacity
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
    levels = array.astype(np.float32, copy=False)
    if array.dtype == np.uint16:
        levels /= np.float32(257.0)
    if levels.ndim == 3:
        levels = levels[:, :, :3] @ np.array([0.299, 0.587, 0.114], dtype=np.float32)
    if not np.isfinite(levels).all():
        raise FrameError("the frame holds numbers that are not finite")
    return np.ascontiguousarray(levels)


def clip_region(region: Box | None, width: int, height: int) -> Box:
    """The part of ``region`` (left, top, width, height) inside a frame of this size.

    Raises:
        RegionError: nothing, or too little to find two edges in, is left; or more than any
            camera's side.
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
            f"the region holds {box[2]} x {box[3]} pixels; at most {MOST_SIDE} a side are looked at"
        )
    return box
