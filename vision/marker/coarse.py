"""Finds the two facing mark edges anywhere in a frame, to about one pixel.

The search averages rows in bands and applies a step filter along each band. It sums the filter
output along every straight line up to 8 degrees from the vertical. Lines with many votes are
edges. A gap is a rising edge (dark to light) with a falling edge to its right and no other edge
between them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from numba import njit

STEP_HALF = 6  # px per side of the step filter; more than twice the widest blur
MAX_SLOPE = 0.14  # 8 degrees; the specified limit is 5
FULL_VOTE = 256  # maximum vote of one band
FLANK = 3  # px of a mark that must be visible beyond its edge

Box = tuple[int, int, int, int]
Image = npt.NDArray[np.uint8] | npt.NDArray[np.float32]
F32 = npt.NDArray[np.float32]


@dataclass(frozen=True)
class EdgeGuess:
    """A straight edge x = x_mid + slope * (y - y_mid), with its sign and votes (bands)."""

    x_mid: float
    slope: float
    rising: bool
    votes: float
    contrast: float = 0.0  # grey levels, median over the bands that show it
    room_left: float = 0.0  # px to the next edge (or the border) on this side
    room_right: float = 0.0


@dataclass(frozen=True)
class Guess:
    """Result of the coarse search; ``reason`` explains why there is no pair of edges."""

    left: EdgeGuess | None
    right: EdgeGuess | None
    reason: str = ""


@njit(cache=True, nogil=True)
def _bands(img, top, left, width, count, band):  # type: ignore[no-untyped-def]
    out = np.zeros((count, width), np.float32)
    scale = np.float32(1.0 / band)
    for k in range(count):
        acc = np.zeros(width, np.float32)
        for y in range(top + k * band, top + (k + 1) * band):
            for x in range(width):
                acc[x] += np.float32(img[y, left + x])
        for x in range(width):
            out[k, x] = acc[x] * scale
    return out


@njit(cache=True, nogil=True)
def _steps(bands, half, flank):  # type: ignore[no-untyped-def]
    """Mean light right of each pixel boundary 0..width minus mean light left of it."""
    count, width = bands.shape
    out = np.zeros((count, width + 1), np.float32)
    total = np.zeros(width + 1, np.float64)
    for k in range(count):
        for x in range(width):
            total[x + 1] = total[x] + bands[k, x]
        for x in range(flank, width + 1 - flank):
            lo = max(0, x - half)
            hi = min(width, x + half)
            right = (total[hi] - total[x]) / (hi - x)
            left = (total[x] - total[lo]) / (x - lo)
            out[k, x] = right - left
    return out


@njit(cache=True, nogil=True)
def _add(total, part):  # type: ignore[no-untyped-def]
    for x in range(total.shape[0]):
        total[x] += part[x]


@njit(cache=True, nogil=True)
def _vote(steps, offsets, dead, cap, pad):  # type: ignore[no-untyped-def]
    """Capped sums of rising and falling steps along lines, at every second column."""
    count, full = steps.shape
    width = full // 2
    up = np.zeros((count, width + 2 * pad), np.int16)
    down = np.zeros((count, width + 2 * pad), np.int16)
    scale = np.float32(FULL_VOTE) / cap
    for k in range(count):
        for x in range(width):
            v = max(steps[k, 2 * x], steps[k, 2 * x + 1])
            if v > dead:
                up[k, x + pad] = np.int16(min(v * scale, np.float32(FULL_VOTE)))
            v = -min(steps[k, 2 * x], steps[k, 2 * x + 1])
            if v > dead:
                down[k, x + pad] = np.int16(min(v * scale, np.float32(FULL_VOTE)))
    slopes = offsets.shape[0]
    rising = np.zeros((slopes, width), np.int16)
    falling = np.zeros((slopes, width), np.int16)
    for s in range(slopes):
        for k in range(count):
            shift = pad + offsets[s, k]
            _add(rising[s], up[k, shift : shift + width])
            _add(falling[s], down[k, shift : shift + width])
    return rising, falling


def find_edges(img: Image, box: Box, exclude: tuple[Box, ...] = ()) -> Guess:
    """Find the facing edges of reference mark and marker inside ``box``.

    Args:
        img: grey frame, shape (height, width), uint8 or float32 grey levels.
        box: left, top, width, height of the region, inside the frame.
        exclude: boxes (frame coordinates) to ignore.
    """
    left, top, width, height = box
    band = max(1, min(16, height // 24))
    count = height // band
    bands = _bands(img, top, left, width, count, band)
    steps = _steps(bands, STEP_HALF, FLANK)
    mid = (height - 1) / 2.0
    rows = ((np.arange(count) + 0.5) * band - 0.5 - mid).astype(np.float64)
    for e_left, e_top, e_width, e_height in exclude:
        hit = (rows + mid + band / 2 + top >= e_top) & (
            rows + mid - band / 2 + top <= e_top + e_height
        )
        lo = max(0, e_left - left - STEP_HALF)
        hi = max(0, e_left + e_width - left + STEP_HALF + 1)
        steps[hit, lo:hi] = 0.0
    strength = np.abs(steps).max(axis=1)
    cap = float(np.sort(strength)[int(0.9 * (count - 1))])
    noise = 1.4826 * float(np.median(np.abs(steps[:, FLANK:-FLANK:5])))
    if cap < max(6.0, 3.0 * noise):
        return Guess(None, None, "no edge stands out from the noise in the region")
    lines = max(9, 2 * int(np.ceil(MAX_SLOPE * height / 2 / 1.2)) + 1)
    slopes = np.linspace(-MAX_SLOPE, MAX_SLOPE, lines).astype(np.float64)
    offsets = np.rint(0.5 * slopes[:, None] * rows[None, :]).astype(np.int64)
    dead = np.float32(max(3.0 * noise, 0.2 * cap))
    pad = int(np.abs(offsets).max()) + 1
    rising, falling = _vote(steps, offsets, dead, np.float32(0.8 * cap), pad)
    least = max(2.0, 24.0 / band, 0.04 * count)
    edges = [*_peaks(rising, slopes, mid, True, least), *_peaks(falling, slopes, mid, False, least)]
    return _choose([_with_contrast(e, steps, rows, float(dead)) for e in edges], width)


def _peaks(
    votes: npt.NDArray[np.int16],
    slopes: npt.NDArray[np.float64],
    half: float,
    rising: bool,
    least: float,
) -> list[EdgeGuess]:
    found: list[EdgeGuess] = []
    rest = votes.copy()
    columns = np.arange(votes.shape[1])[None, :]
    for _ in range(8):
        s, x = divmod(int(np.argmax(rest)), rest.shape[1])
        best = int(rest[s, x])
        if best < least * FULL_VOTE or (found and best < 0.15 * found[0].votes * FULL_VOTE):
            break
        # for a wide blur the filter output is a plateau: take its middle
        first = max(0, x - 3)
        plateau = np.flatnonzero(rest[s, first : x + 4] >= 0.98 * best)
        centre = 2.0 * (first + float(plateau.mean())) + 0.5
        found.append(EdgeGuess(centre, float(slopes[s]), rising, best / FULL_VOTE))
        # a line that crosses this one inside the region has the same votes
        reach = (STEP_HALF + 4 + np.abs(slopes - slopes[s]) * half) // 2
        rest[np.abs(columns - x) <= reach[:, None]] = 0
    return found


def _with_contrast(
    edge: EdgeGuess, steps: F32, rows: npt.NDArray[np.float64], dead: float
) -> EdgeGuess:
    x = np.rint(edge.x_mid + edge.slope * rows).astype(np.int64)
    inside = (x >= 0) & (x < steps.shape[1])
    seen = steps[np.flatnonzero(inside), x[inside]] * (1.0 if edge.rising else -1.0)
    seen = seen[seen > dead]
    return replace(edge, contrast=float(np.median(seen)) if len(seen) else 0.0)


def _choose(edges: list[EdgeGuess], width: int) -> Guess:
    """Select the pair of edges of a single light gap between dark marks."""
    if not edges:
        return Guess(None, None, "no straight edge found in the region")
    top = max(e.votes * e.contrast for e in edges)
    # marks may differ in height, so weaker edges count too
    strong = sorted((e for e in edges if e.votes * e.contrast >= 0.2 * top), key=lambda e: e.x_mid)
    runs: list[list[EdgeGuess]] = []
    for e in strong:
        if runs and runs[-1][-1].rising == e.rising:
            runs[-1].append(e)
        else:
            runs.append([e])
    pairs: list[tuple[float, EdgeGuess, EdgeGuess, str]] = []
    for i in range(len(runs) - 1):
        if not runs[i][0].rising:
            continue
        a, reason_a = _strongest(runs[i])
        b, reason_b = _strongest(runs[i + 1])
        if b.x_mid <= a.x_mid:  # two lines that cross in the middle row: no gap between them
            continue
        before = max((e.x_mid for e in strong if e.x_mid < a.x_mid), default=0.0)
        after = min((e.x_mid for e in strong if e.x_mid > b.x_mid), default=float(width))
        beside_a = min(e.x_mid for e in strong if e.x_mid > a.x_mid)
        beside_b = max(e.x_mid for e in strong if e.x_mid < b.x_mid)
        pairs.append(
            (
                min(a.votes * a.contrast, b.votes * b.contrast),
                replace(a, room_left=a.x_mid - before, room_right=beside_a - a.x_mid),
                replace(b, room_left=b.x_mid - beside_b, room_right=after - b.x_mid),
                reason_a or reason_b,
            )
        )
    if not pairs:
        kinds = "one mark" if len(strong) <= 2 else f"{len(strong)} edges but no light gap"
        return Guess(None, None, f"found {kinds}: two dark marks with a light gap are required")
    pairs.sort(key=lambda pair: pair[0], reverse=True)
    if len(pairs) > 1 and pairs[1][0] > 0.5 * pairs[0][0]:
        return Guess(*pairs[0][1:3], f"{len(pairs)} similar light gaps: specify a region")
    return Guess(*pairs[0][1:])


def _strongest(run: list[EdgeGuess]) -> tuple[EdgeGuess, str]:
    """The strongest of adjacent edges of one sign; a reason for doubt if another is similar."""
    ranked = sorted(run, key=lambda e: e.votes * e.contrast, reverse=True)
    if len(ranked) > 1:
        first, second = (e.votes * e.contrast for e in ranked[:2])
        if second > 0.35 * first:
            where = f"columns {ranked[0].x_mid:.0f} and {ranked[1].x_mid:.0f}"
            return ranked[0], f"two similar edges of the same sign ({where})"
    return ranked[0], ""
