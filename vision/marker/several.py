"""Several dark markers along a muscle: the strain between them, the chord and the curvature.

The markers are dark bars across the muscle on a brighter ground, in one row from left to right.
Each edge is fitted as that of a single marker (`vision.marker.pairfit`). The two edges of a light
gap need not be parallel: the gap is the distance of their middles, and the angle of a marker is
that of the normals of its edges.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from vision.gray import Box, clip_region, to_gray
from vision.marker.coarse import EdgeGuess
from vision.marker.lens import Lens
from vision.marker.pairfit import Edges, Fit, edge_doubt, fit_edges

Array = npt.NDArray[np.float64]

LEAST_MARKERS, MOST_MARKERS = 2, 50
LEAST_AREA = 0.25
"""A dark body smaller than this share of the middle one's area is dirt."""
UNALIKE = 1.8
"""A body wider or higher than the middle one by this factor, or by as much less, is no whole
marker: two have merged, or one is partly covered."""
LEAST_CONTRAST = 20.0
U_ROW = 0.3
"""Standard uncertainty, in rows, of where the middle of a marker lies across the muscle."""
U_LARGEST = 0.1
"""A gap with a larger standard uncertainty, in pixels, is refused."""


@dataclass(frozen=True)
class Segment:
    """Between two markers: the light gap in pixels, its change of angle in radians."""

    pixels: float
    u_pixels: float
    turn: float
    u_turn: float


@dataclass(frozen=True)
class MarkerRow:
    """The markers of one frame, from left to right.

    ``chord_px`` is the straight distance between the middles of the facing edges of the first and
    the last marker, ``arc_px`` the length along the circle that bends by ``turn``, and
    ``curvature`` is turn / arc in 1/pixel, positive where the right side is bent upwards.
    ``scatter`` is the standard deviation of the angles of the markers about even bending, in
    radians. nan, and a reason, where they cannot be told apart or an edge is not one.
    """

    segments: tuple[Segment, ...] = ()
    chord_px: float = math.nan
    u_chord_px: float = math.nan
    arc_px: float = math.nan
    turn: float = math.nan
    u_turn: float = math.nan
    curvature: float = math.nan
    u_curvature: float = math.nan
    scatter: float = math.nan
    trusted: bool = False
    reason: str = ""


@dataclass(frozen=True)
class Strain:
    """Strain of each segment against a rest frame, and of all of them together."""

    segments: tuple[float, ...]
    u_segments: tuple[float, ...]
    mean: float
    u_mean: float


def measure_markers(
    frame: npt.NDArray[Any], count: int, region: Box | None = None, lens: Lens | None = None
) -> MarkerRow:
    """Measure a row of markers.

    Args:
        frame: as for :func:`vision.marker.edge.measure_gap`.
        count: how many markers there are.
        region: left, top, width, height that holds the markers; None for the whole frame.
        lens: distortion of the camera; corrects the positions, not the angles.

    Raises:
        RegionError, FrameError: as measure_gap. ValueError: an impossible number of markers.
    """
    if not LEAST_MARKERS <= count <= MOST_MARKERS:
        raise ValueError(f"{count} markers: from {LEAST_MARKERS} to {MOST_MARKERS} are measured")
    gray = np.require(to_gray(frame), np.float32, ["C", "W"])
    box = clip_region(region, gray.shape[1], gray.shape[0])
    bodies = _bodies(gray, box, count)
    if isinstance(bodies, str):
        return MarkerRow(reason=bodies)
    pairs: list[Edges] = []
    for k, (one, other) in enumerate(pairwise(bodies)):
        found = _gap_between(gray, one, other)
        doubt = found if isinstance(found, str) else edge_doubt(found.fits)
        if doubt or isinstance(found, str):
            return MarkerRow(reason=f"between markers {k + 1} and {k + 2}: {doubt}")
        pairs.append(found)
    return _row(pairs, bodies, lens)


def strain(now: MarkerRow, rest: MarkerRow) -> Strain:
    """Strain of a frame against a rest frame with the same markers, both trusted.

    Gaps are compared, so a marker must not stretch itself. The strain needs no calibration.

    Raises:
        ValueError: another number of markers, or a frame that is not trusted.
    """
    if not (now.trusted and rest.trusted) or len(now.segments) != len(rest.segments):
        raise ValueError("both frames must be trusted and show the same markers")
    values, us = [], []
    for a, b in zip(now.segments, rest.segments, strict=True):
        ratio = a.pixels / b.pixels
        values.append(ratio - 1.0)
        us.append(math.hypot(a.u_pixels, ratio * b.u_pixels) / b.pixels)
    total = sum(s.pixels for s in now.segments), sum(s.pixels for s in rest.segments)
    u = [math.sqrt(sum(s.u_pixels**2 for s in row.segments)) for row in (now, rest)]
    ratio = total[0] / total[1]
    return Strain(tuple(values), tuple(us), ratio - 1.0, math.hypot(u[0], ratio * u[1]) / total[1])


@dataclass(frozen=True)
class _Body:
    """A dark body: its box, and the slope of its edges (dx per row)."""

    left: int
    top: int
    width: int
    height: int
    area: int
    slope: float
    x_mid: float
    y_mid: float

    def row_of_edge(self, right: int) -> float:
        """Row of the middle of its right edge (1), or of its left edge (0)."""
        half = 0.5 * self.area / self.height
        return self.y_mid - half * self.slope * (1.0 if right else -1.0)


def _bodies(gray: npt.NDArray[np.float32], box: Box, count: int) -> list[_Body] | str:
    """The dark bodies of the region in order, or why they are not the markers."""
    import cv2

    left, top, width, height = box
    part = np.clip(gray[top : top + height, left : left + width], 0, 255).astype(np.uint8)
    _, dark = cv2.threshold(
        cv2.medianBlur(part, 5), 0, 255, cv2.THRESH_BINARY_INV + cv2.THRESH_OTSU
    )
    inside = dark > 0
    if not inside.any() or inside.all():
        return "no markers: the region is even"
    contrast = float(np.median(part[~inside])) - float(np.median(part[inside]))
    if contrast < LEAST_CONTRAST:
        return f"no markers: a contrast of {contrast:.0f} grey levels"
    number, labels, stats, _ = cv2.connectedComponentsWithStats(dark)
    areas = stats[1:, cv2.CC_STAT_AREA]
    largest = np.sort(areas)[::-1]
    typical = float(np.median(largest[: min(count, len(largest))]))
    which = [k for k in range(1, number) if stats[k, cv2.CC_STAT_AREA] >= LEAST_AREA * typical]
    found = sorted((_body(labels, stats[k], k, left, top) for k in which), key=lambda b: b.x_mid)
    if len(found) != count:
        return f"{len(found)} dark bodies found, {count} markers stated: choose a region"
    middle = [float(np.median([getattr(b, side) for b in found])) for side in ("width", "height")]
    for k, body in enumerate(found):
        for size, usual in zip((body.width, body.height), middle, strict=True):
            if not usual / UNALIKE <= size <= usual * UNALIKE:
                return (
                    f"marker {k + 1} has {body.width} x {body.height} pixels, most have "
                    f"{middle[0]:.0f} x {middle[1]:.0f}: two have merged, or one is partly covered"
                )
        if body.top <= top or body.top + body.height >= top + height:
            return f"marker {k + 1} reaches out of the region"
    for k, (one, other) in enumerate(pairwise(found)):
        rows = min(one.top + one.height, other.top + other.height) - max(one.top, other.top)
        if rows < 0.5 * min(one.height, other.height):
            return f"markers {k + 1} and {k + 2} do not lie side by side"
    return found


def _body(labels: npt.NDArray[np.int32], stats: Any, k: int, left: int, top: int) -> _Body:
    x, y, width, height, area = (int(v) for v in stats)
    rows, columns = np.nonzero(labels[y : y + height, x : x + width] == k)
    inner = (rows > 0.15 * height) & (rows < 0.85 * height)
    y_mid = float(rows.mean())
    off = rows[inner] - y_mid
    slope = float(off @ (columns[inner] - columns[inner].mean()) / max(1.0, float(off @ off)))
    return _Body(
        x + left, y + top, width, height, area, slope,
        float(columns.mean()) + x + left + 0.5, y_mid + y + top,
    )  # fmt: skip


def _gap_between(gray: npt.NDArray[np.float32], one: _Body, other: _Body) -> Edges | str:
    """The facing edges of two neighbours."""
    first, last = int(one.x_mid), math.ceil(other.x_mid)
    upper = max(one.top + 0.06 * one.height, other.top + 0.06 * other.height) + 3
    lower = min(one.top + 0.94 * one.height, other.top + 0.94 * other.height) - 3
    box = (first, math.ceil(upper), last - first, math.floor(lower) - math.ceil(upper))
    if box[3] < 8 or box[2] < 12:
        return "too few pixels"
    y_mid = box[1] + (box[3] - 1) / 2
    guesses = []
    places = []
    for body, sign in ((one, 1.0), (other, -1.0)):
        half = 0.5 * body.area / body.height  # of the bar, measured along a row
        places.append(body.x_mid + sign * half + body.slope * (y_mid - body.y_mid) - first)
    gap = places[1] - places[0]
    if gap < 8.0:
        return "the gap is too narrow"
    rooms = ((places[0], gap), (gap, box[2] - places[1]))
    for body, place, room, rising in zip((one, other), places, rooms, (True, False), strict=True):
        guesses.append(
            EdgeGuess(place, body.slope, rising, 1.0, room_left=room[0], room_right=room[1])
        )
    return fit_edges(gray, box, (guesses[0], guesses[1]))


def _row(pairs: list[Edges], bodies: list[_Body], lens: Lens | None) -> MarkerRow:
    """All segments, the chord and the bending, from the fitted edges."""
    segments, ends = [], []
    for k, pair in enumerate(pairs):
        sides = [
            _middle(fit, bodies[k + side].row_of_edge(1 - side), pair.extra[side], lens)
            for side, fit in enumerate(pair.fits)
        ]
        gap, u = _distance(sides[0], sides[1])
        if u > U_LARGEST:
            return MarkerRow(reason=f"standard uncertainty {u:.3f} pixels of a gap is too large")
        left, right = pair.fits
        turn = math.atan(right.b) - math.atan(left.b)
        segments.append(Segment(gap, u, turn, math.sqrt(left.cov[1, 1] + right.cov[1, 1])))
        ends += sides
    chord, u_chord = _distance(ends[0], ends[-1])
    turn, u_turn, scatter = _even_bending(_angles(pairs))
    half = 0.5 * turn
    arc = chord if abs(half) < 1e-9 else chord * half / math.sin(half)
    return MarkerRow(
        tuple(segments), chord, u_chord, arc, turn, u_turn, turn / arc, u_turn / arc, scatter, True
    )


@dataclass(frozen=True)
class _End:
    """Middle of an edge, the edge's direction, and the variance of its place across it."""

    place: Array
    edge: Array
    variance: float


def _middle(fit: Fit, y: float, extra: float, lens: Lens | None) -> _End:
    """The point of an edge in row ``y``."""
    off = y - fit.y_mid
    place = np.array([fit.a + fit.b * off, y])
    variance = fit.cov[0, 0] + 2.0 * off * fit.cov[0, 1] + off * off * fit.cov[1, 1] + extra
    if lens is not None:
        place = np.array(lens.true(float(place[0]), y))
    return _End(place, np.array([fit.b, 1.0]) / math.hypot(1.0, fit.b), float(variance))


def _distance(one: _End, other: _End) -> tuple[float, float]:
    """Distance of the middles of two edges, and its standard uncertainty.

    Along an edge the middle is known to a row or so. That counts by the angle between the edge and
    the normal of the line to the other marker.
    """
    step = other.place - one.place
    distance = float(np.hypot(*step))
    along = step / distance
    variance = sum(
        end.variance * along[0] ** 2 + (U_ROW * float(end.edge @ along)) ** 2
        for end in (one, other)
    )
    return distance, math.sqrt(variance)


def _angles(pairs: list[Edges]) -> list[tuple[float, float, float]]:
    """Of each marker: place along the row in pixels, angle in radians, variance."""
    out = []
    for k in range(len(pairs) + 1):
        fits = [pairs[k - 1].fits[1]] if k > 0 else []
        fits += [pairs[k].fits[0]] if k < len(pairs) else []
        weights = [1.0 / fit.cov[1, 1] for fit in fits]
        angle = sum(w * math.atan(fit.b) for w, fit in zip(weights, fits, strict=True))
        out.append((sum(fit.a for fit in fits) / len(fits), angle / sum(weights), 1 / sum(weights)))
    return out


def _even_bending(angles: list[tuple[float, float, float]]) -> tuple[float, float, float]:
    """Turn from the first to the last marker by a straight line through the angles.

    Its uncertainty is that of the edges, or that of the scatter where this is larger: bars are put
    on by hand, and a muscle may bend unevenly.
    """
    place, angle, variance = (np.array(v) for v in zip(*angles, strict=True))
    design = np.column_stack([np.ones(len(place)), place])
    weight = 1.0 / variance
    inverse = np.linalg.inv(design.T @ (design * weight[:, None]))
    fit = inverse @ (design.T @ (weight * angle))
    rest = angle - design @ fit
    freedom = len(place) - 2
    factor = max(1.0, float(rest @ (weight * rest)) / freedom) if freedom else 1.0
    span = float(place[-1] - place[0])
    scatter = math.sqrt(float(rest @ rest) / freedom) if freedom else math.nan
    return float(fit[1]) * span, math.sqrt(float(inverse[1, 1]) * factor) * span, scatter
