"""A measured gap between two edges, as a value."""

from __future__ import annotations

from dataclasses import dataclass, field

from vision.gray import Box


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
