"""A second renderer of frames, for an independent count of wrong lengths.

It shares nothing with the method under test or with ``vision_truth``: marks are polygons, drawn
row by row with exact cover of sub-pixels on a grid three times as fine as the sensor; the lens is
a sum of such sub-pixels (disc, Gaussian, motion, or a core with a halo),
the sensor adds up three by three of them, and its noise grows with the light. Damage is drawn by
shapes that the other tests do not use: reflections of lamps, scratches, dust, lost packets.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import cv2
import numpy as np

FINE = 3  # sub-pixels per pixel and axis
KINDS = ("ordinary", "light", "glare", "specks", "rows", "all", "skew")


@dataclass(frozen=True)
class Field:
    """A frame and the truth: the gap between the middles of the facing edges."""

    image: np.ndarray
    gap: float
    kind: str
    said: dict = field(default_factory=dict)


def polygon_cover(points, width: int, height: int) -> np.ndarray:
    """Cover of a convex polygon on the fine grid: exact along a row, middle of the row across."""
    rows = np.arange(height) + 0.5
    first = np.full(height, np.inf)
    last = np.full(height, -np.inf)
    for (x0, y0), (x1, y1) in zip(points, [*points[1:], points[0]], strict=True):
        if y0 == y1:
            continue
        share = (rows - y0) / (y1 - y0)
        x = x0 + share * (x1 - x0)
        crossed = (share >= 0) & (share < 1)
        first = np.where(crossed, np.minimum(first, x), first)
        last = np.where(crossed, np.maximum(last, x), last)
    inside = last > first
    lo = np.where(inside, first, 0.0)[:, None]
    hi = np.where(inside, last, 0.0)[:, None]
    column = np.arange(width)[None, :]
    cover = np.clip(np.minimum(column + 1, hi) - np.maximum(column, lo), 0.0, 1.0)
    return cover.astype(np.float32)


def lens(name: str, size: float) -> np.ndarray:
    """A kernel on the fine grid, even in x and y; ``size`` is its sd along a row in pixels."""
    sd = size * FINE
    reach = math.ceil(3.5 * sd) + 1
    x = np.arange(-reach, reach + 1)
    r2 = x[None, :] ** 2 + x[:, None] ** 2
    if name == "disc":
        kernel = np.clip(2.0 * sd + 0.5 - np.sqrt(r2), 0.0, 1.0)  # a disc of radius R has sd R/2
    elif name == "halo":  # a sharp core and a wide, weak foot
        kernel = 0.85 * np.exp(-0.5 * r2 / (0.8 * sd) ** 2) / 0.64
        kernel = kernel + 0.15 * np.exp(-0.5 * r2 / (1.7 * sd) ** 2) / 2.89
    elif name == "motion":
        along = np.clip(sd * math.sqrt(3.0) + 0.5 - np.abs(x), 0.0, 1.0)
        kernel = along[None, :] * np.exp(-0.5 * x[:, None] ** 2 / (0.5 * FINE) ** 2)
    else:
        kernel = np.exp(-0.5 * r2 / sd**2)
    return (kernel / kernel.sum()).astype(np.float32)


def mark(x: float, y: float, angle: float, side: int, size: tuple[float, float] | None):
    """Corners of a mark, in pixels: its facing edge runs through (x, y) at ``angle`` (radians)."""
    down = np.array([math.sin(angle), math.cos(angle)])  # along the edge
    out = np.array([math.cos(angle), -math.sin(angle)]) * side
    wide, tall = size or (3000.0, 3000.0)
    middle = np.array([x, y])
    return [
        middle + 0.5 * tall * down,
        middle - 0.5 * tall * down,
        middle - 0.5 * tall * down + wide * out,
        middle + 0.5 * tall * down + wide * out,
    ]


def lamps(rng, width: int, height: int, slant: bool) -> np.ndarray:
    """Added light: the reflection of a strip lamp (hard or soft) or of a round one."""
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    light = rng.uniform(20, 160)
    cx, cy = rng.uniform(0.05, 0.95) * width, rng.uniform(0.05, 0.95) * height
    angle = math.radians(rng.uniform(15, 75) * rng.choice([-1, 1]) if slant else 90.0)
    d = (x - cx) * math.cos(angle) + (y - cy) * math.sin(angle)
    half = math.exp(rng.uniform(math.log(0.005), math.log(0.12))) * height
    form = rng.integers(0, 4)
    if form == 0:
        shape = (np.abs(d) < half).astype(np.float32)
    elif form == 1:
        shape = 1.0 / (1.0 + (d / half) ** 4)
    elif form == 2:
        shape = np.clip(1.5 - np.abs(d) / half, 0.0, 1.0)
    else:
        along = -(x - cx) * math.sin(angle) + (y - cy) * math.cos(angle)
        shape = np.exp(-((d / half) ** 2) - (along / (rng.uniform(1, 6) * half)) ** 2)
    return (light * shape).astype(np.float32)


def dust(rng, image: np.ndarray) -> np.ndarray:
    """Dust, scratches, hot and dead pixels: up to 5 % of the frame."""
    out = image.copy()
    height, width = out.shape
    share = rng.uniform(0.005, 0.05) * out.size
    form = rng.integers(0, 4)
    if form == 0:  # single pixels
        for level in (0, 255):
            at = rng.integers(0, out.size, int(share / 2))
            out.flat[at] = level
        return out
    grey = (0, 255) if rng.random() < 0.3 else (int(rng.integers(0, 90)),) * 2
    covered = 0.0
    while covered < share:
        x, y = int(rng.integers(width)), int(rng.integers(height))
        level = int(rng.choice(grey))
        if form == 1:
            axes = (int(rng.integers(1, 4)), int(rng.integers(1, 7)))
            cv2.ellipse(out, (x, y), axes, float(rng.uniform(0, 180)), 0, 360, level, -1)
            covered += math.pi * axes[0] * axes[1]
        elif form == 2:
            long = rng.uniform(5, 40)
            turn = rng.uniform(0, math.pi)
            end = (int(x + long * math.cos(turn)), int(y + long * math.sin(turn)))
            cv2.line(out, (x, y), end, level, 1, cv2.LINE_AA)
            covered += long
        else:
            side = int(rng.integers(1, 6))
            out[y : y + side, x : x + side] = level
            covered += side * side
    return out


def lost_rows(rng, image: np.ndarray) -> np.ndarray:
    """A quarter of the rows lost: black, white, or the last good row again; one block or many."""
    out = image.copy()
    height = out.shape[0]
    lost = np.zeros(height, bool)
    pieces = int(rng.choice([1, 3, 12, height // 4]))
    each = height // 4 // pieces
    for _ in range(pieces):
        first = int(rng.integers(0, height - each))
        lost[first : first + each] = True
    fill = rng.integers(0, 3)
    for y in np.flatnonzero(lost):
        if fill < 2:
            out[y] = 255 * fill
        elif y:
            out[y] = out[y - 1]
    return out


def draw(rng, kind: str, skew_deg: float | None = None) -> Field:
    """A frame of one kind, all of its quantities drawn from ``rng``; the skew may be given."""
    width, height = [(640, 480), (512, 384), (800, 500), (400, 400)][int(rng.integers(0, 4))]
    gap = rng.uniform(0.12, 0.45) * width
    x, y = width * rng.uniform(0.42, 0.58), height * rng.uniform(0.42, 0.58)
    tilt = math.radians(rng.uniform(-4.5, 4.5)) if rng.random() < 0.7 else 0.0
    skew = 0.0
    if kind == "skew":
        skew = math.radians(math.exp(rng.uniform(math.log(0.05), math.log(6.0))))
        skew *= rng.choice([-1.0, 1.0])
    if skew_deg is not None:
        skew = math.radians(skew_deg)
    size = (rng.uniform(30, 90), rng.uniform(0.5, 0.75) * height) if rng.random() < 0.5 else None
    if size is None:  # of a mark that runs out of the frame, the middle is that of the frame
        y = height / 2
    light = rng.uniform(150, 215)
    dark = rng.uniform(15, 70)
    blur = rng.uniform(0.5, 2.0)
    said = {"gap": gap, "tilt": math.degrees(tilt), "skew": math.degrees(skew), "blur": blur}
    across = np.array([math.cos(tilt), -math.sin(tilt)]) * gap / 2
    cover = np.zeros((height * FINE, width * FINE), np.float32)
    for side, turn in ((-1, tilt - skew / 2), (1, tilt + skew / 2)):
        cx, cy = np.array([x, y]) + side * across
        corners = [tuple(p * FINE) for p in mark(cx, cy, turn, side, size)]
        cover += polygon_cover(corners, width * FINE, height * FINE)
    shares = [0.8, 0.0, 0.2, 0.0] if kind == "ordinary" else [0.5, 0.2, 0.15, 0.15]
    name = str(rng.choice(["gauss", "disc", "halo", "motion"], p=shares))
    kernel = lens(name, blur)
    cover = cv2.filter2D(np.minimum(cover, 1.0), -1, kernel, borderType=cv2.BORDER_REPLICATE)
    cover = cv2.resize(cover, (width, height), interpolation=cv2.INTER_AREA)
    scene = light - (light - dark) * cover
    v, u = np.mgrid[-0.5 : 0.5 : height * 1j, -0.5 : 0.5 : width * 1j]
    steep = rng.uniform(0.25, 0.5) if kind == "light" else rng.uniform(0.0, 0.2)
    turn = rng.uniform(0, 2 * math.pi)
    scene = scene * (1 + steep * (u * math.cos(turn) + v * math.sin(turn)) / math.sqrt(2))
    if kind == "light" or rng.random() < 0.3:  # the lens is darker in its corners
        scene = scene * (1 - rng.uniform(0.1, 0.4) * (u * u + v * v))
    if kind in ("glare", "all"):
        for _ in range(int(rng.choice([1, 1, 2]))):
            scene = scene + lamps(rng, width, height, rng.random() < 0.7)
    noise = rng.uniform(0.8, 4.0)
    scene = scene + rng.standard_normal(scene.shape) * noise * np.sqrt(0.3 + 0.7 * scene / 200)
    image = np.clip(np.rint(scene), 0, 255).astype(np.uint8)
    if kind in ("specks", "all"):
        image = dust(rng, image)
    if kind in ("rows", "all"):
        image = lost_rows(rng, image)
    said |= {"y": y, "noise": noise, "lens": name, "light": light, "dark": dark, "size": size}
    return Field(image, gap, kind, said)
