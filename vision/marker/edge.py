"""The width of the light gap between reference mark and marker, with its uncertainty.

See docs/use/length.md for the edge model, the bound it is held to and its measured figures.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from vision.gray import Box, RegionError, clip_region, to_gray

__all__ = ["EdgeLine", "GapMeasurement", "RegionError", "measure_gap"]

F64 = npt.NDArray[np.float64]


@dataclass(frozen=True)
class EdgeLine:
    """A fitted mark edge, x = x_mid + slope * (y - y_mid), in frame pixels.

    x counts from the left border of the first pixel, y in row numbers.
    ``u_x_mid`` is the standard uncertainty of ``x_mid``; ``blur_px`` the sd of the blur
    along the row; ``contrast`` light minus dark, ``noise`` the sd near the edge, both in
    grey levels; ``rows_used`` of ``rows_seen`` rows carried the fit; ``outliers`` is the
    share of pixels near the edge that the fit refused.
    """

    x_mid: float
    slope: float
    y_mid: float
    u_x_mid: float
    top: int
    bottom: int
    blur_px: float
    contrast: float
    noise: float
    rows_used: int
    rows_seen: int
    outliers: float

    def x_at(self, y: float) -> float:
        """Column of the edge at row ``y``."""
        return self.x_mid + self.slope * (y - self.y_mid)


@dataclass(frozen=True)
class GapMeasurement:
    """One frame's answer.

    ``pixels`` is the gap perpendicular to the edges and ``u_pixels`` its standard
    uncertainty, both nan where no gap was found. ``trusted`` is False, and ``reason`` says
    why, where the number must not be used.
    """

    pixels: float
    u_pixels: float
    trusted: bool
    reason: str
    left: EdgeLine | None = None
    right: EdgeLine | None = None
    region: Box = (0, 0, 0, 0)
    polygon: tuple[tuple[float, float], ...] = field(default=())


def measure_gap(
    frame: npt.NDArray[Any],
    region: Box | None = None,
    exclude: tuple[Box, ...] = (),
) -> GapMeasurement:
    """Measure the light gap between two dark marks in one frame.

    Args:
        frame: grey (height, width) or colour (height, width, 3 or 4, RGB order), uint8 or
            uint16.
        region: left, top, width, height to look in; the whole frame when None.
        exclude: boxes that must not count as marks (the sync LED's patch).

    Raises:
        RegionError: the region lies outside the frame or is too small.
        FrameError: the array is not a picture.
    """
    gray = to_gray(frame)
    box = clip_region(region, gray.shape[1], gray.shape[0])
    from vision.marker.pairfit import fit_pair  # numba stays out of start-up

    return fit_pair(gray, box, exclude)
