"""The thesis's method (Appendix C-5): whole pixels, identical to NIH Image.

    FlipHorizontal; SetThreshold(130); MakeBinary; MakeRoi(10,300,500,70);
    GetPlotData(count,ppv,min,max); row:=0; while PlotData[row] = 0 do row:=row+1;

NIH Image's grey scale runs from 0 (white) to 255 (black). The threshold therefore marks pixels
of grey level 125 or less. MakeRoi takes left, top, width, height after the flip. GetPlotData
averages the columns of the rectangle. As in the original, one dark speck ends the count.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from vision.gray import Box, RegionError, to_gray

THRESHOLD = 130
ROI: Box = (10, 300, 500, 70)


class NoMarker(ValueError):
    """No column of the region contains a marked pixel; the original would read beyond its array."""


def macro_profile(
    frame: npt.NDArray[Any], threshold: int = THRESHOLD, roi: Box = ROI, flip: bool = True
) -> npt.NDArray[np.float64]:
    """The profile that the macro scans: share of marked pixels (times 255) in each column.

    Raises:
        RegionError: the roi does not lie inside the frame.
    """
    gray = to_gray(frame)
    left, top, width, height = roi
    right, bottom = left + width, top + height
    if not (0 <= left < right <= gray.shape[1] and 0 <= top < bottom <= gray.shape[0]):
        raise RegionError(
            f"the macro's region {tuple(roi)} (left, top, width, height) does not lie inside the "
            f"frame of {gray.shape[1]} x {gray.shape[0]} pixels: give another with --roi"
        )
    if flip:
        gray = gray[:, ::-1]
    part = gray[top:bottom, left:right]
    marked = 255.0 - part >= threshold if part.dtype != np.uint8 else 255 - part >= threshold
    profile: npt.NDArray[np.float64] = marked.mean(axis=0) * 255.0
    return profile


def measure_macro(
    frame: npt.NDArray[Any], threshold: int = THRESHOLD, roi: Box = ROI, flip: bool = True
) -> int:
    """Number of roi columns before the first one with a marked pixel.

    Args:
        frame: grey or colour, 8 or 16 bit; colour is first converted to grey.
        threshold: NIH grey value (0 white, 255 black) from which a pixel is marked.
        roi: left, top, width, height in the (flipped) frame.
        flip: mirror the frame left to right first, as the macro does.

    Raises:
        NoMarker: no column contains a marked pixel.
        RegionError: the roi does not lie inside the frame.
    """
    profile = macro_profile(frame, threshold, roi, flip)
    hit = np.flatnonzero(profile)
    if len(hit) == 0:
        raise NoMarker(
            f"no marker: none of the {roi[2]} columns of the region {tuple(roi)} holds a pixel "
            f"of NIH grey value {threshold} or more (grey level {255 - threshold} or less)"
        )
    return int(hit[0])
