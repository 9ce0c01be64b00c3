"""Frames with known truth, rendered independently of everything under test.

A mark is a half-plane or a rectangle. Seen through an isotropic Gaussian blur a half-plane
is the normal distribution function of the distance to its border; a square pixel integrates
that. The double integral is done in closed form: with P3 the second integral of the normal
distribution function (its third antiderivative counting the density), the mean over a unit
pixel is a signed sum of P3 at its four corners divided by sin*cos of the tilt. Rectangles
are products in the tilted frame and are integrated by Gauss-Legendre quadrature.
Without blur the same formulas give exact area coverage.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr

HEIGHT, WIDTH = 480, 640


@dataclass(frozen=True)
class Scene:
    """Truth of one frame; ``x`` is where the middle of the gap crosses the middle row."""

    gap: float = 150.0
    x: float = 320.0
    tilt_deg: float = 0.0
    blur: float = 1.0
    noise: float = 3.0
    light: float = 200.0
    dark: float = 40.0
    gradient: float = 0.0  # relative change of light over the frame's longer half diagonal
    gradient_deg: float = 0.0
    left_width: float | None = None  # None: the mark reaches beyond the frame
    right_width: float | None = None
    left_rows: tuple[float, float] | None = None  # None: over all rows
    right_rows: tuple[float, float] | None = None
    smear: float = 0.0  # motion blur along the row, on the left mark
    width: int = WIDTH
    height: int = HEIGHT


def _p2(t, s):
    if s <= 0:
        return np.maximum(t, 0.0)
    z = t / s
    return t * ndtr(z) + s * np.exp(-0.5 * z * z) / np.sqrt(2 * np.pi)


def _p3(t, s):
    if s <= 0:
        return 0.5 * np.maximum(t, 0.0) ** 2
    z = t / s
    pdf = np.exp(-0.5 * z * z) / np.sqrt(2 * np.pi)
    return 0.5 * ((t * t + s * s) * ndtr(z) + t * s * pdf)


def half_plane(d, tilt, blur):
    """Mean over unit pixels of the blurred half-plane; d: signed distance of pixel centres."""
    c, s = np.cos(tilt), abs(np.sin(tilt))
    if s < 1e-9:
        return _p2(d + 0.5, blur) - _p2(d - 0.5, blur)
    a, b = 0.5 * (c + s), 0.5 * (c - s)
    return (_p3(d + a, blur) - _p3(d + b, blur) - _p3(d - b, blur) + _p3(d - a, blur)) / (c * s)


def _cover(scene: Scene, edge: float, side: int, width, rows, smear: float):
    """Cover of one mark: facing edge at u = edge, mark on its ``side`` (-1 left, +1 right)."""
    tilt = np.radians(scene.tilt_deg)
    c, s = np.cos(tilt), np.sin(tilt)
    x = np.arange(scene.width) + 0.5 - scene.x
    y = np.arange(scene.height) + 0.5 - scene.height / 2
    if smear > 0:
        shifts = ((np.arange(24) + 0.5) / 24 - 0.5) * smear
        parts = [
            _cover(replace(scene, x=scene.x + q), edge, side, width, rows, 0.0) for q in shifts
        ]
        return np.mean(parts, axis=0)
    u = x[None, :] * c - y[:, None] * s
    reach = 8.5 * scene.blur + 2.0  # beyond it the normal distribution is 0 or 1 to 1e-16
    if width is None and rows is None:
        d = (u[: 1 if scene.tilt_deg == 0.0 else None] - edge) * side  # upright: rows are alike
        out = (d > 0).astype(np.float64)
        near = np.abs(d) < reach
        out[near] = half_plane(d[near], tilt, scene.blur)
        return np.broadcast_to(out, u.shape)
    nodes, weights = np.polynomial.legendre.leggauss(5)
    width = 4000.0 if width is None else width
    v0, v1 = (-4000.0, 4000.0) if rows is None else (r - scene.height / 2 for r in rows)
    blur = max(scene.blur, 1e-6)
    d = (u - edge) * side
    v = x[None, :] * s + y[:, None] * c
    out = ((d > 0) & (d < width) & (v > v0) & (v < v1)).astype(np.float64)
    near = (np.abs(d) < reach) | (np.abs(d - width) < reach)
    near |= (np.abs(v - v0) < reach) | (np.abs(v - v1) < reach)
    near &= (d > -reach) & (d < width + reach) & (v > v0 - reach) & (v < v1 + reach)
    d, v = d[near], v[near]
    total = np.zeros(d.shape)
    for p, wp in zip(nodes / 2, weights / 2, strict=True):
        for q, wq in zip(nodes / 2, weights / 2, strict=True):
            uu = d + (p * c - q * s) * side
            vv = v + p * s + q * c
            part = (ndtr(uu / blur) - ndtr((uu - width) / blur)) * (
                ndtr((vv - v0) / blur) - ndtr((vv - v1) / blur)
            )
            total += wp * wq * part
    out[near] = total
    return out


def clean(scene: Scene):
    """Noise-free frame in grey levels, float64."""
    cover = _cover(scene, -scene.gap / 2, -1, scene.left_width, scene.left_rows, scene.smear)
    cover = cover + _cover(scene, scene.gap / 2, +1, scene.right_width, scene.right_rows, 0.0)
    frame = scene.light - (scene.light - scene.dark) * cover
    if scene.gradient:
        a = np.radians(scene.gradient_deg)
        x = (np.arange(scene.width) + 0.5) / scene.width - 0.5
        y = (np.arange(scene.height) + 0.5) / scene.height - 0.5
        ramp = np.cos(a) * x[None, :] + np.sin(a) * y[:, None]
        frame = frame * (1.0 + scene.gradient * ramp / (abs(np.cos(a)) + abs(np.sin(a))))
    return frame


def digitise(frame, noise: float, rng):
    noisy = rng.standard_normal(frame.shape) if noise > 0 else np.zeros(frame.shape)
    noisy *= noise
    noisy += frame
    np.rint(noisy, out=noisy)
    return np.clip(noisy, 0, 255, out=noisy).astype(np.uint8)


def picture(scene: Scene, rng):
    return digitise(clean(scene), scene.noise, rng)


def cramer_rao(scene: Scene) -> float:
    """Least standard deviation, in pixels, of any unbiased estimate of the gap.

    The frame is f(theta) plus white Gaussian noise of variance noise^2 + 1/12 (rounding), so
    the Fisher information is J^T J / variance, J = df/dtheta by central differences of the
    renderer itself. theta = gap, position, tilt, blur, light, dark and the two gradient
    components: what has to be found out together with the gap.
    """
    gx = scene.gradient * np.cos(np.radians(scene.gradient_deg))
    gy = scene.gradient * np.sin(np.radians(scene.gradient_deg))

    def frame(theta):
        g, x, tilt, blur, light, dark, dx, dy = theta
        base = replace(
            scene, gap=g, x=x, tilt_deg=tilt, blur=blur, light=light, dark=dark, gradient=0.0
        )
        u = (np.arange(scene.width) + 0.5) / scene.width - 0.5
        v = (np.arange(scene.height) + 0.5) / scene.height - 0.5
        return clean(base) * (1 + dx * u[None, :] + dy * v[:, None])

    norm = abs(np.cos(np.radians(scene.gradient_deg))) + abs(np.sin(np.radians(scene.gradient_deg)))
    theta = np.array(
        [
            scene.gap,
            scene.x,
            scene.tilt_deg,
            scene.blur,
            scene.light,
            scene.dark,
            gx / norm,
            gy / norm,
        ]
    )
    steps = [1e-3, 1e-3, 1e-3, 1e-3, 0.1, 0.1, 1e-3, 1e-3]
    columns = []
    for k, h in enumerate(steps):
        up, down = theta.copy(), theta.copy()
        up[k] += h
        down[k] -= h
        columns.append(((frame(up) - frame(down)) / (2 * h)).ravel())
    jac = np.stack(columns, axis=1)
    scale = np.sqrt((jac**2).sum(axis=0))
    info = (jac / scale).T @ (jac / scale) / (scene.noise**2 + 1 / 12)
    return float(np.sqrt(np.linalg.inv(info)[0, 0]) / scale[0])
