"""Draws what a camera sees of flat marks in a plane: ArUco marks and ChArUco boards.

The patterns are those of the dictionary 4x4_50 of OpenCV, as 16 bits a mark, row by row, 1 for
light. Perspective, distortion and the share that each pixel sees are worked out here from the
equations of the pinhole with Brown's distortion; nothing of the detector is used.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from plant.arrays import Array

Cover = npt.NDArray[np.bool_]

PATTERNS = bytes.fromhex(
    "B5320F9A332D9946549E79CD9E2EC4F2FEDACF56F99111A70EB72A0F24B1263E46656600"
    "6C5E76AF868BB02BCCD5DD82FE479471ACE4A5542123346F441557B29ECFF0CB08AE0929"
    "187504FF0DF61C5A17182A28328C38B224E82EEB2D3F4B64502E5013"
)
"""The 50 marks of 4 x 4 squares, two bytes each."""
PARTS = 4
"""Samples across and down in a pixel."""


@dataclass(frozen=True)
class MarkCamera:
    """Pinhole, distortion, sensor, and how it looks at the plane.

    ``distance_mm`` is that from the lens to the plane's origin; ``tilt_deg`` turns the plane about
    the picture's horizontal and vertical axis; ``roll_deg`` turns it in the picture, anticlockwise;
    ``centre`` is the pixel at which the origin is seen without distortion.
    """

    width: int = 640
    height: int = 480
    focal_px: float = 900.0
    k1: float = 0.0
    k2: float = 0.0
    distance_mm: float = 300.0
    tilt_deg: tuple[float, float] = (0.0, 0.0)
    roll_deg: float = 0.0
    centre: tuple[float, float] = (319.5, 239.5)
    light: float = 200.0
    dark: float = 40.0
    blur_px: float = 0.8
    noise: float = 2.0


@dataclass(frozen=True)
class Drawn:
    """One body in the plane: a mark by number, or a board of squares where ``columns`` is given.

    x and y in mm (y up), the angle in degrees anticlockwise; ``side_mm`` is that of the mark, or of
    a square of the board, whose marks have ``mark_mm``.
    """

    number: int = 0
    side_mm: float = 20.0
    x_mm: float = 0.0
    y_mm: float = 0.0
    angle_deg: float = 0.0
    height_mm: float = 0.0
    columns: int = 0
    rows: int = 0
    mark_mm: float = 0.0


def draw_marks(
    bodies: Sequence[Drawn], rng: np.random.Generator, camera: MarkCamera | None = None
) -> npt.NDArray[np.uint8]:
    """One picture (height, width) of marks on a light plane.

    Args:
        bodies: later ones cover earlier ones.
        rng: of the sensor's noise.
        camera: how it looks.
    """
    return draw_moving([bodies], rng, camera)


def draw_moving(
    instants: Sequence[Sequence[Drawn]],
    rng: np.random.Generator,
    camera: MarkCamera | None = None,
) -> npt.NDArray[np.uint8]:
    """One picture of marks that move: the mean of what is seen at some instants of the exposure.

    Args:
        instants: the bodies at each.
        rng: of the noise of the sensor.
        camera: how it looks.
    """
    m = camera or MarkCamera()
    pixels = np.mean([_light(bodies, m) for bodies in instants], axis=0)
    noisy = pixels + rng.normal(0.0, m.noise, pixels.shape)
    return np.asarray(np.clip(np.rint(noisy), 0, 255), dtype=np.uint8)


Box = tuple[int, int, int, int]
"""Left, top, right, bottom in pixels, the last two not included."""


def _light(bodies: Sequence[Drawn], m: MarkCamera) -> Array:
    """Grey levels (height, width) without noise; only the surroundings of marks are worked out."""
    pixels = np.full((m.height, m.width), m.light)
    margin = 2 + math.ceil(5.0 * m.blur_px)
    for box, members in _groups([_box(b, m, margin) for b in bodies]):
        left, top, right, bottom = box
        pixels[top:bottom, left:right] = _part(box, tuple(bodies[k] for k in members), m)
    return pixels


@lru_cache(maxsize=8)
def _part(box: Box, bodies: tuple[Drawn, ...], m: MarkCamera) -> npt.NDArray[np.float32]:
    """Grey levels of a part of the picture; kept, because a mark beside the axis stays as it is."""
    from scipy.ndimage import gaussian_filter

    left, top, right, bottom = box
    fine = np.full(((bottom - top) * PARTS, (right - left) * PARTS), m.light, dtype=np.float32)
    for body in bodies:
        _draw(fine, body, m, left, top)
    if m.blur_px > 0.0:
        fine = gaussian_filter(fine, m.blur_px * PARTS, mode="nearest", truncate=4.0)
    parts = fine.reshape(bottom - top, PARTS, right - left, PARTS)
    made: npt.NDArray[np.float32] = parts.mean(axis=(1, 3))
    return made


def _groups(boxes: Sequence[Box]) -> list[tuple[Box, list[int]]]:
    """Boxes that overlap, together in one; which of the given ones are in each."""
    groups: list[tuple[Box, list[int]]] = []
    for k, box in enumerate(boxes):
        left, top, right, bottom = box
        if right <= left or bottom <= top:  # outside of the picture
            continue
        members = [k]
        while near := [g for g in groups if _overlap(g[0], (left, top, right, bottom))]:
            for group in near:
                groups.remove(group)
                members += group[1]
                other = group[0]
                left, top = min(left, other[0]), min(top, other[1])
                right, bottom = max(right, other[2]), max(bottom, other[3])
        groups.append(((left, top, right, bottom), sorted(members)))
    return groups


def _overlap(one: Box, other: Box) -> bool:
    return one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3]


def seen_at(camera: MarkCamera, x_mm: float, y_mm: float, height_mm: float = 0.0) -> Array:
    """Pixel at which a point of the plane is seen; the centre of the first pixel is (0, 0)."""
    turn, shift = _plane(camera)
    before = turn @ np.array([x_mm, y_mm, height_mm]) + shift
    u, v = before[0] / before[2], before[1] / before[2]
    r2 = u * u + v * v
    factor = 1.0 + camera.k1 * r2 + camera.k2 * r2 * r2
    middle = np.array([(camera.width - 1) / 2.0, (camera.height - 1) / 2.0])
    return np.asarray(middle + camera.focal_px * factor * np.array([u, v]))


def _plane(m: MarkCamera) -> tuple[Array, Array]:
    """Rotation and translation from the plane (x right, y up, z to the camera) to the camera."""
    a, b, c = (math.radians(v) for v in (*m.tilt_deg, m.roll_deg))
    flip = np.diag([1.0, -1.0, -1.0])
    about_x = np.array(
        [[1, 0, 0], [0, math.cos(a), -math.sin(a)], [0, math.sin(a), math.cos(a)]], dtype=float
    )
    about_y = np.array(
        [[math.cos(b), 0, math.sin(b)], [0, 1, 0], [-math.sin(b), 0, math.cos(b)]], dtype=float
    )
    about_z = np.array(
        [[math.cos(c), -math.sin(c), 0], [math.sin(c), math.cos(c), 0], [0, 0, 1]], dtype=float
    )
    u = (m.centre[0] - (m.width - 1) / 2.0) / m.focal_px
    v = (m.centre[1] - (m.height - 1) / 2.0) / m.focal_px
    return flip @ about_x @ about_y @ about_z, m.distance_mm * np.array([u, v, 1.0])


def _box(body: Drawn, m: MarkCamera, margin: int) -> Box:
    """Where a body is seen, with a margin, as far as it is in the picture."""
    wide, tall = _size(body)
    c, s = math.cos(math.radians(body.angle_deg)), math.sin(math.radians(body.angle_deg))
    edge = np.linspace(-0.5, 0.5, 9)
    rim = [(wide * a, tall * b) for a in edge for b in edge]
    seen = np.array(
        [
            seen_at(m, body.x_mm + c * x - s * y, body.y_mm + s * x + c * y, body.height_mm)
            for x, y in rim
        ]
    )
    low = np.maximum(np.floor(seen.min(axis=0)).astype(int) - margin, 0)
    high = np.ceil(seen.max(axis=0)).astype(int) + 1 + margin
    high = np.minimum(high, [m.width, m.height])
    return int(low[0]), int(low[1]), int(high[0]), int(high[1])


def _size(body: Drawn) -> tuple[float, float]:
    """Width and height in mm."""
    if body.columns:
        return body.columns * body.side_mm, body.rows * body.side_mm
    return body.side_mm, body.side_mm


def _draw(fine: npt.NDArray[np.float32], body: Drawn, m: MarkCamera, left: int, top: int) -> None:
    """One body into a part of the picture, whose first pixel is given."""
    wide, tall = _size(body)
    c, s = math.cos(math.radians(body.angle_deg)), math.sin(math.radians(body.angle_deg))
    rows_px, columns_px = fine.shape
    across_px = (left * PARTS + np.arange(columns_px))[None, :]
    down_px = (top * PARTS + np.arange(rows_px))[:, None]
    # Shifted within a sample, so that a side along the rows meets 16 places of a pixel, not 4.
    columns = (across_px + (down_px % PARTS + 0.5) / PARTS) / PARTS - 0.5
    rows = (down_px + (across_px % PARTS + 0.5) / PARTS) / PARTS - 0.5
    x, y = _on_plane(m, columns, rows, body.height_mm)
    dx, dy = x - body.x_mm, y - body.y_mm
    right, up = c * dx + s * dy, c * dy - s * dx
    across, down = right + wide / 2.0, tall / 2.0 - up
    dark, inside = (_board if body.columns else _mark)(body, across, down)
    fine[inside] = np.where(dark, m.dark, m.light)[inside]


def _on_plane(m: MarkCamera, column: Array, row: Array, height_mm: float) -> tuple[Array, Array]:
    """Where the rays of pixels meet the plane at a height."""
    xd = (column - (m.width - 1) / 2.0) / m.focal_px
    yd = (row - (m.height - 1) / 2.0) / m.focal_px
    xu, yu = np.broadcast_arrays(xd, yd)
    for _ in range(8 if m.k1 or m.k2 else 0):
        r2 = xu * xu + yu * yu
        factor = 1.0 + m.k1 * r2 + m.k2 * r2 * r2
        xu, yu = xd / factor, yd / factor
    turn, shift = _plane(m)
    eye = -turn.T @ shift
    rays = [turn[0, k] * xu + turn[1, k] * yu + turn[2, k] for k in range(3)]
    depth = (height_mm - eye[2]) / rays[2]
    return eye[0] + depth * rays[0], eye[1] + depth * rays[1]


def _mark(body: Drawn, across: Array, down: Array) -> tuple[Cover, Cover]:
    """Dark or not, and whether on the mark at all."""
    return _pattern(body.number, across / body.side_mm, down / body.side_mm)


def _pattern(number: int, across: Array, down: Array) -> tuple[Cover, Cover]:
    """The mark over the unit square: six squares a side, the outer ones dark."""
    column, row = np.floor(across * 6.0).astype(int), np.floor(down * 6.0).astype(int)
    inside = (column >= 0) & (column < 6) & (row >= 0) & (row < 6)
    within = (column >= 1) & (column < 5) & (row >= 1) & (row < 5)
    bit = 15 - (np.clip(row - 1, 0, 3) * 4 + np.clip(column - 1, 0, 3))
    word = PATTERNS[2 * number] << 8 | PATTERNS[2 * number + 1]
    light = within & (((word >> bit) & 1) == 1)
    return np.asarray(~light), np.asarray(inside)


def _board(body: Drawn, across: Array, down: Array) -> tuple[Cover, Cover]:
    """Squares dark and light in turn, upper left dark, with a mark in every light one."""
    column = np.floor(across / body.side_mm).astype(int)
    row = np.floor(down / body.side_mm).astype(int)
    inside = (column >= 0) & (column < body.columns) & (row >= 0) & (row < body.rows)
    dark: Cover = inside & ((column + row) % 2 == 0)
    number, edge = body.number, (body.side_mm - body.mark_mm) / 2.0
    for r in range(body.rows):
        for q in range(body.columns):
            if (q + r) % 2 == 0:
                continue
            in_square = (column == q) & (row == r)
            a = (across[in_square] - q * body.side_mm - edge) / body.mark_mm
            b = (down[in_square] - r * body.side_mm - edge) / body.mark_mm
            own, on_mark = _pattern(number, a, b)
            dark[in_square] = own & on_mark
            number += 1
    return dark, inside
