"""Result types of a gap measurement."""

from __future__ import annotations

from dataclasses import dataclass

from vision.gray import Box


@dataclass(frozen=True)
class EdgeLine:
    """A fitted edge of a mark, x = x_mid + slope * (y - y_mid), in frame pixels.

    x is measured from the left border of the first pixel, y in row numbers. ``u_x_mid`` is the
    standard uncertainty of ``x_mid``; ``blur_px`` the sd of the blur along the row;
    ``contrast`` light minus dark and ``noise`` the sd near the edge, in grey levels;
    ``rows_used`` of ``rows_seen`` rows contribute to the fit; ``outliers`` is the share of
    rejected pixels near the edge.
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
    """The result for one frame.

    ``pixels`` is the gap perpendicular to the edges and ``u_pixels`` its standard uncertainty,
    both nan if no gap was found. If ``trusted`` is False, the value must not be used;
    ``reason`` explains why.
    """

    pixels: float
    u_pixels: float
    trusted: bool
    reason: str
    left: EdgeLine | None = None
    right: EdgeLine | None = None
    region: Box = (0, 0, 0, 0)
