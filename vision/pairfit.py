"""Joins coarse search and edge fits into one trusted, or flagged, measurement."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vision.coarse import EdgeGuess, Image, find_edges
from vision.edge import EdgeLine, GapMeasurement
from vision.edgefit import CORE_MAX, PARAMETERS, refine, start_line
from vision.gray import Box

F64 = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Fit:
    """One fitted edge with its covariance at ``y_mid``."""

    a: float
    b: float
    y_mid: float
    cov: F64
    p: F64
    out: F64
    rows: npt.NDArray[np.int64]
    keep: npt.NDArray[np.uint8]
    resid: npt.NDArray[np.float32]
    smear: float = 0.0


def fit_pair(gray: Image, box: Box, exclude: tuple[Box, ...]) -> GapMeasurement:
    """Find, fit, judge. ``box`` must lie inside ``gray``."""
    guess = find_edges(gray, box, exclude)
    if guess.left is None or guess.right is None:
        return GapMeasurement(math.nan, math.nan, False, guess.reason, region=box)
    left = _fit_edge(gray, box, guess.left, exclude)
    right = _fit_edge(gray, box, guess.right, exclude)
    if left is None or right is None:
        side = "left" if left is None else "right"
        reason = f"the {side} edge of the gap is not one straight edge"
        return GapMeasurement(math.nan, math.nan, False, reason, region=box)
    return _combine(left, right, box, guess.reason)


def _fit_edge(
    gray: Image, box: Box, guess: EdgeGuess, exclude: tuple[Box, ...]
) -> Fit | None:
    left, top, width, height = box
    y_mid = top + (height - 1) / 2
    group = max(2, min(8, height // 8))
    reach_l = max(3.0, min(11.0, 0.9 * guess.room_left))
    reach_r = max(3.0, min(11.0, 0.9 * guess.room_right))
    a, b, low, high, used = start_line(
        gray, box, y_mid, left + guess.x_mid, guess.slope, guess.rising, reach_l, reach_r, group
    )
    if a < 0:
        return None
    marked = used.astype(bool)
    wide = marked.copy()
    wide[1:] |= marked[:-1]
    wide[:-1] |= marked[1:]
    rows = np.flatnonzero(np.repeat(wide, group)).astype(np.int64) + top
    if rows[-1] == top + len(used) * group - 1:
        rows = np.concatenate([rows, np.arange(rows[-1] + 1, top + height, dtype=np.int64)])
    for e_left, e_top, e_width, e_height in exclude:
        x = a + b * (rows - y_mid)
        hit = (rows >= e_top) & (rows < e_top + e_height)
        hit &= (x > e_left - 25) & (x < e_left + e_width + 25)
        rows = rows[~hit]
    if len(rows) < 8:
        return None
    own_mid = 0.5 * float(rows[0] + rows[-1])
    half = max(1.0, 0.5 * float(rows[-1] - rows[0]))
    p = np.zeros(PARAMETERS)
    p[0], p[1], p[2], p[3], p[6] = a + b * (own_mid - y_mid), b, 1.4, low, high
    room = np.array([max(3.0, 0.55 * guess.room_left), max(3.0, 0.55 * guess.room_right)])
    resid = np.zeros((len(rows), CORE_MAX), dtype=np.float32)
    keep = np.zeros(len(rows), dtype=np.uint8)
    out = np.zeros(12)
    if not refine(gray, rows, own_mid, half, p, 0.0, room, left, left + width, resid, keep, out):
        return None
    cov = np.array([[out[0], out[1]], [out[1], out[2]]])
    return Fit(p[0], p[1], own_mid, cov, p, out, rows, keep, resid)


def _combine(left: Fit, right: Fit, box: Box, doubt: str) -> GapMeasurement:
    y = 0.5 * (left.y_mid + right.y_mid)
    weight_l, weight_r = 1 / left.cov[1, 1], 1 / right.cov[1, 1]
    slope = (left.b * weight_l + right.b * weight_r) / (weight_l + weight_r)
    apart = abs(left.b - right.b)
    u_apart = math.sqrt(left.cov[1, 1] + right.cov[1, 1])
    if apart < 4 * u_apart + 1e-4:  # parallel as far as can be told: one slope for both
        x_l = left.a + left.cov[0, 1] / left.cov[1, 1] * (slope - left.b)
        x_r = right.a + right.cov[0, 1] / right.cov[1, 1] * (slope - right.b)
        x_l += slope * (y - left.y_mid)
        x_r += slope * (y - right.y_mid)
        var = (
            left.cov[0, 0] - left.cov[0, 1] ** 2 / left.cov[1, 1]
            + right.cov[0, 0] - right.cov[0, 1] ** 2 / right.cov[1, 1]
        )
        arm = (right.y_mid - left.y_mid) + 0.0
        var += arm**2 / (weight_l + weight_r)
    else:
        y = box[1] + (box[3] - 1) / 2
        x_l = left.a + left.b * (y - left.y_mid)
        x_r = right.a + right.b * (y - right.y_mid)
        var = 0.0
        for fit in (left, right):
            d = y - fit.y_mid
            var += fit.cov[0, 0] + 2 * d * fit.cov[0, 1] + d * d * fit.cov[1, 1]
    cosine = 1 / math.sqrt(1 + slope * slope)
    gap = (x_r - x_l) * cosine
    u = math.sqrt(var) * cosine
    u = math.hypot(u, gap * slope * cosine**2 / math.sqrt(weight_l + weight_r))
    lines = [_line(left), _line(right)]
    reason = doubt
    corners = []
    for line, order in ((lines[0], 1), (lines[1], -1)):
        ends = [(line.x_at(line.top), float(line.top)), (line.x_at(line.bottom), float(line.bottom))]
        corners += ends[::order]
    return GapMeasurement(
        gap, u, not reason, reason, lines[0], lines[1], box, tuple(corners)
    )


def _line(fit: Fit) -> EdgeLine:
    kept = fit.rows[fit.keep > 0]
    return EdgeLine(
        x_mid=fit.a,
        slope=fit.b,
        y_mid=fit.y_mid,
        u_x_mid=math.sqrt(fit.cov[0, 0]),
        top=int(kept[0]),
        bottom=int(kept[-1]),
        blur_px=float(fit.p[2]),
        smear_px=fit.smear,
        contrast=abs(float(fit.out[7])),
        noise=float(fit.out[3]),
        rows_used=int(fit.out[5]),
        rows_seen=len(fit.rows),
        outliers=float(fit.out[4]),
    )
