"""Contribution of JPEG compression to the uncertainty of an edge.

A straight vertical edge puts the same content into every block row, so the rounding of its DCT
coefficients does not average out over rows. The error of the coefficient of horizontal
frequency u is at most half its quantiser step (variance q^2/12), or the coefficient itself
where it was rounded to zero. Sensor noise reduces the error: the mean error of a quantiser
under Gaussian noise of sd s has the variance q^2/(2 pi^2) exp(-4 pi^2 s^2/q^2). Each error
moves the edge by the inner product of its cosine with the influence of the pixels on the fit.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from vision.marker.coarse import Image

F64 = npt.NDArray[np.float64]

# a few large coefficients cause these errors, and the robust fit reacts to them
UNLIKE_GAUSS = 1.4

# ITU-T T.81 Annex K.1, luminance, as scaled by the usual encoders
_BASE = np.array(
    [
        [16, 11, 10, 16, 24, 40, 51, 61],
        [12, 12, 14, 19, 26, 58, 60, 55],
        [14, 13, 16, 24, 40, 57, 69, 56],
        [14, 17, 22, 29, 51, 87, 80, 62],
        [18, 22, 37, 56, 68, 109, 103, 77],
        [24, 35, 55, 64, 81, 104, 113, 92],
        [49, 64, 78, 87, 103, 121, 120, 101],
        [72, 92, 95, 98, 112, 100, 103, 99],
    ],
    dtype=np.float64,
)
_DCT = np.sqrt(2 / 8) * np.cos((2 * np.arange(8)[None, :] + 1) * np.arange(8)[:, None] * np.pi / 16)
_DCT[0] /= np.sqrt(2)


@dataclass(frozen=True)
class JpegQuantiser:
    """Quantiser steps by [vertical, horizontal] frequency, and the sensor noise before them."""

    quality: int
    steps: F64
    noise: float

    @property
    def pixel_error(self) -> float:
        """Rms error of a pixel from rounding of vertical content, grey levels."""
        return float(np.sqrt(np.sum(self.steps[0, 1:] ** 2) / 12 / 64))


def table(quality: int) -> F64:
    """Luminance quantiser of the common encoders at ``quality`` (50..100), shape (8, 8)."""
    steps: F64 = np.clip(np.floor((_BASE * (200 - 2 * quality) + 50) / 100), 1, 255)
    return steps


@lru_cache(maxsize=1)
def _qualities() -> tuple[npt.NDArray[np.int64], F64]:
    qualities = np.arange(50, 93)
    return qualities, np.stack([table(int(q)) for q in qualities])


def find_quantiser(img: Image, columns: F64, rows: npt.NDArray[np.int64]) -> JpegQuantiser | None:
    """Detect JPEG quantisation in the blocks along the edges.

    Args:
        img: grey frame, decoded.
        columns, rows: points on the edges; their blocks and both neighbours are used.

    Returns:
        None if the coefficients do not fit the quantiser of a common encoder.
    """
    places = ((rows // 8) * 4096 + (columns // 8).astype(np.int64))[:, None]
    own = np.unique(places + np.array([-1, 0, 1]))
    edge = _coefficients(img, own // 4096, own % 4096)
    if len(edge) < 12:
        return None
    qualities, tables = _qualities()
    part = np.concatenate([edge[:, 0, 1:7], edge[:, 1, 1:4]], axis=1)
    steps = np.concatenate([tables[:, 0, 1:7], tables[:, 1, 1:4]], axis=1)[:, None, :]
    # only non-zero coefficients show the step, and small steps are not distinguishable
    informative = (np.abs(part) > 1.5)[None] & (steps >= 3.5)
    score = (np.cos(2 * np.pi * part[None] / steps) * informative).sum(axis=(1, 2))
    count = informative.sum(axis=(1, 2))
    good = (score > 0.65 * count) & (count >= 16)
    if not good.any():
        return None
    best = int(np.argmax(np.where(good, score, -np.inf)))
    found = tables[best]
    off = np.unique(places + np.array([-4, 4]))
    flat = _coefficients(img, off // 4096, off % 4096)
    noise = 0.0
    if len(flat) >= 6:
        low = flat[:, [0, 1, 1], [1, 0, 1]] / found[[0, 1, 1], [1, 0, 1]]
        noise = float(_undither(np.mean(np.minimum(low**2, 25.0))) * found[1, 0])
    return JpegQuantiser(int(qualities[best]), found, noise)


def _coefficients(
    img: Image, block_rows: npt.NDArray[np.int64], block_columns: npt.NDArray[np.int64]
) -> F64:
    """DCT of the 8 x 8 blocks at these positions that lie inside the frame."""
    height, width = img.shape
    fits = (block_columns >= 0) & (8 * block_columns + 8 <= width)
    fits &= (block_rows >= 0) & (8 * block_rows + 8 <= height)
    inner = np.arange(8)
    y = 8 * block_rows[fits, None, None] + inner[:, None]
    x = 8 * block_columns[fits, None, None] + inner
    coefficients: F64 = _DCT @ (img[y, x].astype(np.float64) - 128.0) @ _DCT.T
    return coefficients


@lru_cache(maxsize=1)
def _dither_curve() -> tuple[F64, F64]:
    """Variance after a unit quantiser as a function of the noise sd before it."""
    from scipy.special import ndtr

    sd = np.linspace(0.08, 4.0, 200)
    k = np.arange(-20, 21)
    share = ndtr((k + 0.5) / sd[:, None]) - ndtr((k - 0.5) / sd[:, None])
    return sd, np.asarray((share * k**2).sum(axis=1))


def _undither(variance: float) -> float:
    sd, after = _dither_curve()
    return float(np.interp(variance, after, sd, left=0.0))


def position_variance(
    quantiser: JpegQuantiser,
    x0: float,
    slope: float,
    rows: int,
    sigma: float,
    levels: tuple[float, float],
) -> float:
    """Variance (px^2) of an edge's position due to rounding of the coefficients.

    Rounding errors common to all block rows count fully. The other errors (dithered by noise)
    are independent for each block row.

    Args:
        x0: the edge's column; slope: columns per row; rows: number of fitted rows.
        sigma: blur; levels: light left and right of the edge.
    """
    from scipy.special import ndtr

    low, high = levels
    reach = 12.0 + 6.0 * sigma
    first = 8 * int((x0 - reach) // 8)
    count = 8 * (int((x0 + reach) // 8) - first // 8 + 1)

    def profile(at: float) -> tuple[F64, F64, F64]:
        d = np.arange(first, first + count, dtype=np.float64) + 0.5 - at
        near, far = (d + 0.5) / sigma, (d - 0.5) / sigma
        f = ndtr(near) * near - ndtr(far) * far
        f = sigma * (f + (np.exp(-0.5 * near**2) - np.exp(-0.5 * far**2)) / np.sqrt(2 * np.pi))
        return d, f, ndtr(near) - ndtr(far)

    d, f, g = profile(x0)
    width = np.exp(-0.5 * ((d + 0.5) / sigma) ** 2) - np.exp(-0.5 * ((d - 0.5) / sigma) ** 2)
    light = low * (1 - f) + high * f
    design = np.stack([-(high - low) * g, width, 1 - f, f, d * light], axis=1)
    inside = np.abs(d) <= reach
    design *= inside[:, None]
    scale = np.sqrt(np.einsum("ij,ij->j", design, design))
    unit = design / scale
    influence = np.linalg.solve(unit.T @ unit + 1e-10 * np.eye(5), unit.T)[0] / scale[0]
    steps = quantiser.steps[0]
    content = np.sqrt(8) * (light.reshape(-1, 8) @ _DCT.T)
    _, f1, _ = profile(x0 + 0.05)
    moved = np.sqrt(8) * ((low * (1 - f1) + high * f1).reshape(-1, 8) @ _DCT.T)
    rate = np.abs(moved - content) / 0.05
    weight = influence.reshape(-1, 8) @ _DCT.T / np.sqrt(8)
    # the exponent is sensitive to the noise estimate, so 0.85 is a conservative factor
    dither = np.exp(-4 * np.pi**2 * (0.85 * quantiser.noise) ** 2 / steps**2)
    error2 = np.minimum(steps**2 / 12, steps**2 / (2 * np.pi**2) * dither)
    error2 = np.broadcast_to(error2, content.shape)
    lost = np.abs(content) < 0.5 * steps
    error2 = np.where(lost, np.minimum(error2, content**2), error2)
    cycles = rate * abs(slope) * rows / steps
    # a tilted edge crosses the pixel grid, and the error oscillates about zero
    independent = np.clip((2.0 * cycles) ** 2, 1.0, max(1.0, rows / 8))
    loose = np.where(lost, error2, steps**2 / 12)
    variance = weight**2 * (error2 / independent + loose / max(1.0, rows / 8))
    return UNLIKE_GAUSS * float(np.sum(variance))
