"""Corners of a dark square as the crossings of lines through its four sides.

Each side is crossed by short profiles at right angles. The place of the edge in a profile is that
of a sharp step with the same area under it, which a symmetric blur does not move. The places are
freed of the lens distortion, and a line is fitted to them.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

ENDS = 0.14
"""Share of a side at each end that is left out: there the blurred corner is round."""
STEP_PX = 0.5
LONGEST_PX = 7.0
LEAST_KEPT = 0.7
"""Share of the profiles that must lie on the line: otherwise something covers the side."""
LARGEST_SD_PX = 0.5


class BadSide(ValueError):
    """A side of the mark is not a straight edge; the text states why."""


def crossings(
    gray: npt.NDArray[np.uint8], corners: Array, undistorted: Callable[[Array], Array], squares: int
) -> tuple[Array, float]:
    """Corners (4, 2) without lens distortion, in the order of the rough ones, and their noise.

    The noise is the standard deviation of a co-ordinate in pixels, from the scatter of the places
    about the lines.

    Args:
        gray: picture (h, w).
        corners: rough corners (4, 2) of a dark square on light ground, clockwise as seen.
        undistorted: takes pixels (n, 2) to where a lens without distortion would show them.
        squares: squares along a side, with the dark border.

    Raises:
        BadSide: a side is covered, cut or not straight.
    """
    rough = np.asarray(corners, dtype=np.float64)
    for _ in range(2):
        lines = [_line(gray, rough[k], rough[(k + 1) % 4], lambda p: p, squares) for k in range(4)]
        rough = _meet(lines)
    lines = [_line(gray, rough[k], rough[(k + 1) % 4], undistorted, squares) for k in range(4)]
    return _meet(lines), float(np.sqrt(np.mean([line[2] ** 2 for line in lines])))


def _meet(lines: list[tuple[Array, Array, float]]) -> Array:
    """Corner k is where side k - 1 meets side k; a line is a point and a unit normal."""
    out = []
    for k in range(4):
        (p, n, _), (q, m, _) = lines[k - 1], lines[k]
        normals = np.array([n, m])
        if abs(np.linalg.det(normals)) < 0.05:
            raise BadSide("two sides are nearly parallel")
        out.append(np.linalg.solve(normals, np.array([n @ p, m @ q])))
    return np.array(out)


def _line(
    gray: npt.NDArray[np.uint8], a: Array, b: Array, undistorted: Callable[[Array], Array],
    squares: int,
) -> tuple[Array, Array, float]:  # fmt: skip
    """Line through the side from a to b: a point of it, its unit normal, its noise at an end."""
    import cv2

    length = float(np.hypot(*(b - a)))
    along = (b - a) / length
    outwards = np.array([along[1], -along[0]])  # the mark lies to the right of a to b, y down
    reach = float(np.clip(0.45 * length / squares, 1.5, LONGEST_PX))
    count = max(8, round((1.0 - 2.0 * ENDS) * length))
    feet = a + np.linspace(ENDS, 1.0 - ENDS, count)[:, None] * (b - a)
    number = 2 * round(reach / STEP_PX) + 1
    offsets = np.linspace(-reach, reach, number)
    points = (feet[:, None] + offsets[:, None] * outwards).astype(np.float32)
    low, high = points.min(axis=(0, 1)), points.max(axis=(0, 1))
    if low.min() < 0.0 or high[0] > gray.shape[1] - 1 or high[1] > gray.shape[0] - 1:
        raise BadSide("a side is too near to the border of the picture")
    levels = np.asarray(
        cv2.remap(gray.astype(np.float32), points[..., 0], points[..., 1], cv2.INTER_LINEAR),
        dtype=np.float64,
    )
    few = max(2, number // 6)
    dark, light = float(np.median(levels[:, :few])), float(np.median(levels[:, -few:]))
    if light - dark < 1.0:
        raise BadSide("a side has no contrast")
    step = offsets[1] - offsets[0]
    filled = (levels - dark) / (light - dark)
    area = step * (filled.sum(axis=1) - 0.5 * (filled[:, 0] + filled[:, -1]))
    places = undistorted(feet + (reach - area)[:, None] * outwards)
    return _fit(places)


def _fit(places: Array) -> tuple[Array, Array, float]:
    """A straight line, without the places that do not lie on it."""
    kept = np.ones(len(places), dtype=bool)
    middle, normal = places.mean(axis=0), np.zeros(2)
    for _ in range(4):
        middle = places[kept].mean(axis=0)
        _, _, axes = np.linalg.svd(places[kept] - middle, full_matrices=False)
        normal = axes[1]
        off = (places - middle) @ normal
        sd = 1.4826 * float(np.median(np.abs(off[kept] - np.median(off[kept]))))
        within = np.abs(off) <= max(3.5 * sd, 0.05)
        if (within == kept).all():
            break
        kept = within
        if kept.mean() < LEAST_KEPT:
            raise BadSide("a side is covered or not straight")
    sd = float(np.std((places[kept] - middle) @ normal))
    if sd > LARGEST_SD_PX:
        raise BadSide("a side is not a sharp straight edge")
    # Variance of a line at the end of a side, from n places over its inner part w = 1 - 2 ENDS:
    # sd^2 / n (1 + (1/2)^2 / (w^2 / 12)).
    inner = 1.0 - 2.0 * ENDS
    return middle, normal, sd * float(np.sqrt((1.0 + 3.0 / inner**2) / int(kept.sum())))
