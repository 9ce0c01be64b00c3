"""Measures the width of the light gap between reference mark and marker, with uncertainty.

docs/use/length.md describes the edge model, its uncertainty limit and measured performance.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from vision.gray import Box, clip_region, to_gray
from vision.marker.gap import GapMeasurement
from vision.marker.pairfit import fit_pair


def measure_gap(
    frame: npt.NDArray[Any], region: Box | None = None, exclude: tuple[Box, ...] = ()
) -> GapMeasurement:
    """Measure the light gap between two dark marks in one frame.

    Args:
        frame: grey (height, width) or colour (height, width, 3 or 4, RGB order), uint8 or
            uint16.
        region: search region: left, top, width, height; None for the whole frame.
        exclude: boxes that contain no marks (the sync LED's patch).

    Raises:
        RegionError: the region lies outside the frame or is too small.
        FrameError: the array is not a picture.
    """
    # One type, which may be written to: for any other the compiler translates all of it again,
    # and a first colour picture, or in mid-test a first frame from a socket, takes 15 s.
    gray = np.require(to_gray(frame), np.float32, ["C", "W"])
    box = clip_region(region, gray.shape[1], gray.shape[0])

    return fit_pair(gray, box, exclude)
