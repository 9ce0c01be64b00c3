"""Combines coarse search and edge fits into one measurement, trusted or rejected with a reason."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from vision.gray import Box
from vision.marker.coarse import EdgeGuess, Image, find_edges
from vision.marker.edgefit import refine
from vision.marker.edgestart import start_line
from vision.marker.edgesweep import CORE_MAX, GROUP, Line, Rows
from vision.marker.gap import EdgeLine, GapMeasurement
from vision.marker.jpegerror import JpegQuantiser, find_quantiser, position_variance

F64 = npt.NDArray[np.float64]

LEAST_NOISE = 0.3  # grey levels: rounding to integers
DRAWN_SCALE = 0.03  # of the contrast: allowed model error of a synthetic picture without noise
OVEREXPOSED = 254.5
ROWS_ALIKE = 1.25  # above this, errors of neighbouring rows are correlated: compression or lines
COLUMNS_ALIKE = 2.5  # the same for sums over all rows
LOPSIDED = 6.0  # even misfit common to all rows, relative to noise, that noise cannot explain
LOPSIDED_GAIN = 4.0
STEEPEST = math.tan(math.radians(7.0))
LARGEST_U = 0.05  # px; a frame with a larger uncertainty is rejected
LARGEST_U_DEFECTS = 0.05 / 3  # where part of the pixels was rejected
SCATTER_GAIN = 3.0  # a few rows decide on the scatter between parts of an edge
LEAST_OUTLIERS = 0.001  # of the pixels near an edge; noise alone gives 0.000003
AXIS_U = 0.1 / math.sqrt(12)  # of the common rows: the muscle's axis is in their middle tenth


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
    group_of: npt.NDArray[np.int64]
    keep: npt.NDArray[np.uint8]
    resid: npt.NDArray[np.float32]
    levels: F64
    on: npt.NDArray[np.uint8]
    seen: int
    drawn: bool


def fit_pair(gray: Image, box: Box, exclude: tuple[Box, ...]) -> GapMeasurement:
    """Find both edges, fit them and check the result. ``box`` must lie inside ``gray``."""
    guess = find_edges(gray, box, exclude)
    if guess.left is None or guess.right is None:
        return GapMeasurement(math.nan, math.nan, False, guess.reason, region=box)
    found = fit_edges(gray, box, (guess.left, guess.right), exclude)
    if isinstance(found, str):
        return GapMeasurement(math.nan, math.nan, False, found, region=box)
    doubt = guess.reason or _rejection_reason(found.fits)
    return _combine(found.fits[0], found.fits[1], found.extra, box, doubt, found.limit)


@dataclass(frozen=True)
class Edges:
    """Both edges of a gap, the variances to add to their positions, the largest uncertainty."""

    fits: list[Fit]
    extra: list[float]
    limit: float


def fit_edges(
    gray: Image, box: Box, guesses: tuple[EdgeGuess, EdgeGuess], exclude: tuple[Box, ...] = ()
) -> Edges | str:
    """Fit the left and the right edge of a gap; a text states why an edge is none.

    Args:
        gray: picture, float32. box: region inside it; positions of the guesses count from its left
            side. exclude: boxes without edges.
    """
    fits: list[Fit] = []
    for side, edge in zip(("left", "right"), guesses, strict=True):
        fit = _fit_edge(gray, box, edge, exclude)
        if fit is None:
            reason = f"the {side} edge of the gap is not one straight edge"
            first, last = int(guesses[0].x_mid) + 4, int(guesses[1].x_mid) - 4
            lit = gray[box[1] : box[1] + box[3], box[0] + first : box[0] + max(first + 1, last)]
            if lit.size and np.median(lit) >= OVEREXPOSED:
                reason = f"over-exposed at the {side} edge: reduce light or exposure time"
            return reason
        fits.append(fit)
    extra = [0.0, 0.0]
    limit = LARGEST_U
    alike = max(fit.out[12] for fit in fits) > ROWS_ALIKE
    scattered = any(_scatter(fit) > 1.0 for fit in fits)
    if alike or scattered or max(fit.out[13] for fit in fits) > COLUMNS_ALIKE:
        quantiser = _quantiser(gray, fits)
        if quantiser is not None:
            fits, extra = _allow_for_rounding(gray, box, fits, guesses, quantiser)
        elif all(fit.drawn for fit in fits):
            extra = [_rounding_variance(fit) for fit in fits]
        else:
            extra = [_misfit_variance(fit) + _scatter_variance(fit) for fit in fits]
            if scattered:
                limit = LARGEST_U_DEFECTS
    return Edges(fits, extra, limit)


def _quantiser(gray: Image, fits: list[Fit]) -> JpegQuantiser | None:
    points = [(fit.a + fit.b * (fit.rows[::32] - fit.y_mid), fit.rows[::32]) for fit in fits]
    columns, rows = (np.concatenate([p[k] for p in points]) for k in (0, 1))
    return find_quantiser(gray, columns, rows)


def _allow_for_rounding(
    gray: Image,
    box: Box,
    fits: list[Fit],
    guesses: tuple[EdgeGuess, EdgeGuess],
    quantiser: JpegQuantiser,
) -> tuple[list[Fit], list[float]]:
    """Fits and added variances for a frame with correlated errors of neighbouring rows (JPEG)."""
    floor = 1.5 * quantiser.pixel_error
    again: list[Fit] = []
    extra: list[float] = []
    for fit, guess in zip(fits, guesses, strict=True):
        better: Fit | None = fit
        if fit.out[3] < floor or fit.out[11] > 0:
            better = _refit(gray, box, fit, guess, floor)
        again.append(better or fit)
        noise2 = max(1.0, (quantiser.noise / again[-1].out[3]) ** 2) - 1.0
        levels = (float(np.median(fit.levels[:, 0])), float(np.median(fit.levels[:, 1])))
        extra.append(
            again[-1].cov[0, 0] * noise2
            + position_variance(quantiser, fit.a, fit.b, int(fit.out[5]), fit.p[2], levels)
        )
    return again, extra


def _rounding_variance(fit: Fit) -> float:
    """Variance to add where no noise dithers the rounding to integer grey levels.

    Rows that cross the pixel grid at the same phase have the same rounding error. After a
    twentieth of a pixel of tilt the error is independent.
    """
    rows = float(fit.out[5])
    independent = min(rows, max(1.0, 20.0 * abs(fit.b) * rows))
    return float(fit.cov[0, 0] / max(fit.out[14], 1e-12) * rows / independent / 12)


def _misfit_variance(fit: Fit) -> float:
    """Variance to add for residuals common to all rows that JPEG does not explain.

    A non-Gaussian kernel (motion) causes residuals that are odd about the edge and do not move
    it. Two odd functions remove them. The remaining even residuals (glare, reflections) move
    the edge by an unknown multiple of their size.
    """
    alike = max(0.0, fit.out[12] - 1.0) if fit.out[12] > ROWS_ALIKE else 0.0
    residual = fit.resid * (fit.keep[:, None] > 0)
    seen = np.count_nonzero(residual, axis=0)
    columns = np.flatnonzero(seen > 0.3 * seen.max())
    x0 = fit.a + fit.b * (fit.rows - fit.y_mid)
    d = columns - CORE_MAX // 2 + 0.5 - float(np.mean(x0 - np.floor(x0)))
    mean = residual[:, columns].sum(axis=0) / np.sqrt(seen[columns]) / fit.out[3]
    odd = np.exp(-0.5 * ((d + 0.5) / fit.p[2]) ** 2) - np.exp(-0.5 * ((d - 0.5) / fit.p[2]) ** 2)
    basis = np.stack([odd, odd * d**2, odd * d**4], axis=1)
    basis /= np.linalg.norm(basis, axis=0) + 1e-12
    rest = mean - basis @ np.linalg.lstsq(basis, mean, rcond=None)[0]
    even = float(np.sum(rest**2)) / max(1, len(columns) - 7)
    if even < LOPSIDED:
        explained = float(np.sum(mean**2) - np.sum(rest**2)) / max(1e-9, float(np.sum(mean**2)))
        return float(fit.cov[0, 0] * alike * (1.0 - explained))
    return float(fit.cov[0, 0] * (alike + LOPSIDED_GAIN * even))


def _scatter(fit: Fit) -> float:
    """Scatter between parts of an edge (``row_scatter``), 1 where nothing else shows damage."""
    damaged = (
        fit.out[12] > ROWS_ALIKE or fit.out[4] > LEAST_OUTLIERS or fit.out[6] + fit.out[10] > 0
    )
    return float(fit.out[15]) if damaged else 1.0


def _scatter_variance(fit: Fit) -> float:
    """Variance to add where parts of the edge lie apart by more than their rows' noise."""
    scatter = _scatter(fit)
    return float(fit.cov[0, 0] * (SCATTER_GAIN * scatter - 1.0)) if scatter > 1.0 else 0.0


def _refit(gray: Image, box: Box, fit: Fit, guess: EdgeGuess, least_scale: float) -> Fit | None:
    p, levels, on, out = fit.p.copy(), fit.levels.copy(), np.ones_like(fit.on), np.zeros(16)
    p[4] = 0.0
    resid, keep = np.zeros_like(fit.resid), np.zeros_like(fit.keep)
    view = Rows(
        gray, fit.rows, fit.group_of, fit.y_mid, _room(guess), box[0], box[0] + box[2], OVEREXPOSED
    )
    if not refine(view, Line(p, levels, on), least_scale, False, resid, keep, out):
        return None
    cov = np.array([[out[0], out[1]], [out[1], out[2]]])
    return replace(
        fit, a=p[0], b=p[1], p=p, levels=levels, on=on, out=out, resid=resid, keep=keep, cov=cov
    )


def _rejection_reason(fits: list[Fit]) -> str:
    """Why a pair of fits must be rejected; "" if it is accepted."""
    doubt = edge_doubt(fits)
    if doubt:
        return doubt
    if abs(fits[0].b - fits[1].b) > 0.03:
        return "the two edges are not parallel"
    return _narrow(fits)


def edge_doubt(fits: list[Fit]) -> str:
    """Why one of the two edges must be rejected; "" if both are accepted."""
    for side, fit in zip(("left", "right"), fits, strict=True):
        rows, edge = fit.out[5], f"the {side} edge"
        if fit.out[8] > 0.5 * fit.seen:
            return f"over- or under-exposed at {edge}"
        if rows < 0.45 * fit.seen:
            return f"only {rows:.0f} of {fit.seen} rows fit {edge}"
        if fit.out[4] > 0.15:
            return f"{100 * fit.out[4]:.0f} % of the pixels near {edge} are outliers"
        if fit.out[9] > 0.3:
            return f"the light beside {edge} is uneven"
        if fit.p[2] > 6.0:
            return f"{edge} is too blurred ({fit.p[2]:.1f} pixels)"
        if abs(fit.b) > STEEPEST:
            return f"{edge} is tilted by {math.degrees(math.atan(fit.b)):.1f} degrees"
    noises = sorted(fit.out[3] for fit in fits)
    if noises[1] > 2.0 * max(noises[0], 1.0):
        return "one edge has much more noise than the other: light or dirt beside it"
    return ""


def _narrow(fits: list[Fit]) -> str:
    if fits[1].a - fits[0].a < 3.0 * (fits[0].p[2] + fits[1].p[2]) + 3.0:
        return "the gap is too narrow for its blur"
    return ""


def _fit_edge(gray: Image, box: Box, guess: EdgeGuess, exclude: tuple[Box, ...]) -> Fit | None:
    left, top, width, height = box
    y_mid = top + (height - 1) / 2
    group = max(2, min(8, height // 8))
    reach_l = max(3.0, min(11.0, 0.9 * guess.room_left))
    reach_r = max(3.0, min(11.0, 0.9 * guess.room_right))
    a, b, lows, highs, used = start_line(
        gray, box, y_mid, left + guess.x_mid, guess.slope, guess.rising, reach_l, reach_r, group
    )
    if a < 0:
        return None
    marked = used.astype(bool)
    if not marked.any():
        return None
    wide = marked.copy()
    wide[1:] |= marked[:-1]
    wide[:-1] |= marked[1:]
    rows = np.flatnonzero(np.repeat(wide, group)).astype(np.int64) + top
    seen = len(rows)
    for e_left, e_top, e_width, e_height in exclude:
        x = a + b * (rows - y_mid)
        hit = (rows >= e_top) & (rows < e_top + e_height)
        hit &= (x > e_left - 25) & (x < e_left + e_width + 25)
        rows = rows[~hit]
    if len(rows) < 8:
        return None
    own_mid = 0.5 * float(rows[0] + rows[-1])
    p = np.array([a + b * (own_mid - y_mid), b, 1.4, 0.0, 0.0])
    block = (rows - top) // group
    # groups without own levels start from the nearest marked group
    known = np.flatnonzero(marked)
    nearest = known[np.argmin(np.abs(np.arange(len(used))[:, None] - known[None, :]), axis=1)]
    _, first, group_of = np.unique((rows - top) // GROUP, return_index=True, return_inverse=True)
    source = nearest[block[first]]
    levels = np.stack([lows[source], highs[source]], axis=1)
    on = np.ones(len(levels), dtype=np.uint8)
    # a synthetic picture may be exactly 255; a camera has noise in dark areas
    reach = min(8.0, 0.8 * (guess.room_left if guess.rising else guess.room_right))
    beside = (a - reach if guess.rising else a + reach) + b * (rows - y_mid)
    dark = gray[rows, np.clip(beside.astype(np.int64), left, left + width - 1)].astype(np.float64)
    drawn = float(np.mean(np.abs(np.diff(dark)) > 0)) < 0.05
    hot_from = 1e9 if drawn else OVEREXPOSED
    step = float(np.median(np.abs(levels[:, 1] - levels[:, 0])))
    least = max(LEAST_NOISE, DRAWN_SCALE * step) if drawn else LEAST_NOISE
    resid = np.zeros((len(rows), CORE_MAX), dtype=np.float32)
    keep = np.zeros(len(rows), dtype=np.uint8)
    out = np.zeros(16)
    view = Rows(gray, rows, group_of, own_mid, _room(guess), left, left + width, hot_from)
    if not refine(view, Line(p, levels, on), least, True, resid, keep, out):
        return None
    cov = np.array([[out[0], out[1]], [out[1], out[2]]])
    # a fit may leave the edge that it was started on for a place without one
    contrast = out[7] if guess.rising else -out[7]
    if not (contrast > LEAST_NOISE and np.isfinite(cov).all() and cov.diagonal().min() > 0.0):
        return None
    return Fit(
        p[0], p[1], own_mid, cov, p, out, rows, group_of, keep, resid, levels, on, seen, drawn
    )


def _room(guess: EdgeGuess) -> F64:
    """Columns left and right of an edge that belong to it, not to the next edge."""
    return np.array([max(3.0, 0.55 * guess.room_left), max(3.0, 0.55 * guess.room_right)])


def _combine(
    left: Fit, right: Fit, extra: list[float], box: Box, doubt: str, limit: float
) -> GapMeasurement:
    y = 0.5 * (left.y_mid + right.y_mid)
    weight_l, weight_r = 1 / left.cov[1, 1], 1 / right.cov[1, 1]
    slope = (left.b * weight_l + right.b * weight_r) / (weight_l + weight_r)
    apart = abs(left.b - right.b)
    u_apart = math.sqrt(left.cov[1, 1] + right.cov[1, 1])
    var = extra[0] + extra[1]
    skew_u = 0.0
    if apart < 4 * u_apart + 1e-4:  # parallel within uncertainty: one slope for both
        bend_l = left.cov[0, 1] / left.cov[1, 1]
        bend_r = right.cov[0, 1] / right.cov[1, 1]
        x_l = left.a + bend_l * (slope - left.b) + slope * (y - left.y_mid)
        x_r = right.a + bend_r * (slope - right.b) + slope * (y - right.y_mid)
        var += left.cov[0, 0] - left.cov[0, 1] * bend_l
        var += right.cov[0, 0] - right.cov[0, 1] * bend_r
        arm = left.y_mid - right.y_mid + bend_r - bend_l
        var += arm**2 / (weight_l + weight_r)
    else:
        y, rows = _common_rows(left, right)
        x_l = left.a + left.b * (y - left.y_mid)
        x_r = right.a + right.b * (y - right.y_mid)
        for fit in (left, right):
            d = y - fit.y_mid
            var += fit.cov[0, 0] + 2 * d * fit.cov[0, 1] + d * d * fit.cov[1, 1]
        skew_u = AXIS_U * rows * apart
    cosine = 1 / math.sqrt(1 + slope * slope)
    gap = (x_r - x_l) * cosine
    u = math.sqrt(var) * cosine
    u = math.hypot(u, gap * slope * cosine**2 / math.sqrt(weight_l + weight_r))
    u = math.hypot(u, skew_u)
    reason = doubt
    defects = any(
        f.out[4] > 0.02 or f.out[5] < 0.7 * f.seen or f.out[11] > 0 for f in (left, right)
    )
    if defects:
        limit = LARGEST_U_DEFECTS
    if not reason and skew_u > limit:
        allowed = int(rows * limit / skew_u)
        reason = (
            f"the edges are rotated against each other by {math.degrees(apart):.2f} degrees: align "
            f"the marks, or choose a region of {allowed} rows at the muscle's axis"
        )
    if not reason and u > limit:
        reason = f"standard uncertainty {u:.3f} pixels is above {limit:.3f}"
    return GapMeasurement(float(gap), float(u), not reason, reason, _line(left), _line(right), box)


def _common_rows(left: Fit, right: Fit) -> tuple[float, float]:
    """Middle and number of the rows that show both edges, or of the rows between them."""
    kept = [fit.rows[fit.keep > 0] for fit in (left, right)]
    first, last = max(rows[0] for rows in kept), min(rows[-1] for rows in kept)
    return 0.5 * float(first + last), 1.0 + abs(float(last - first))


def _line(fit: Fit) -> EdgeLine:
    kept = fit.rows[fit.keep > 0]
    return EdgeLine(
        x_mid=float(fit.a),
        slope=float(fit.b),
        y_mid=fit.y_mid,
        u_x_mid=math.sqrt(fit.cov[0, 0]),
        top=int(kept[0]),
        bottom=int(kept[-1]),
        blur_px=float(fit.p[2]),
        contrast=abs(float(fit.out[7])),
        noise=float(fit.out[3]),
        rows_used=int(fit.out[5]),
        rows_seen=fit.seen,
        outliers=float(fit.out[4]),
    )
