"""One least-squares fit of the plane and of every body in it to the corners of one picture.

Unknown are the pose of the plane before the camera (6 numbers) and of each body in the plane (x, y,
angle). The plane of a calibration enters as a measurement with its covariance; without one, a
reference body defines the plane and its origin. The variance of the corners is that of their
residuals, pooled with what corners have in general (`CORNER_PX`) and by the noise of the picture,
since a picture with two marks leaves only seven degrees of freedom.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vision.pose.camera import PoseCamera

Array = npt.NDArray[np.float64]

CORNER_PX = 0.03
"""Standard deviation of one co-ordinate of a corner without noise: what the pixels leave."""
CORNER_FREEDOM = 6.0
"""Weight of it, in degrees of freedom."""
LARGEST_RESIDUAL_PX = 0.6
"""Above this rms residual a body is bent, not in the plane, or of another size than stated."""


class NoSolution(ValueError):
    """The corners fit no pose; the text states why."""


@dataclass(frozen=True)
class Body:
    """One rigid body: points on it in mm (n, 3), x right, y up, z towards the camera, and pixels.

    ``pixels`` (n, 2) are those that a lens without distortion would show; ``noise_px`` is the
    standard deviation of one co-ordinate of them by the noise of the picture, where it is known.
    """

    name: str
    points: Array
    pixels: Array
    noise_px: float = 0.0


@dataclass(frozen=True)
class Solution:
    """The fit.

    ``plane`` holds rotation vector and translation, ``plane_covariance`` theirs. ``bodies`` has
    x and y in mm and the angle in radians of each body, ``covariance`` (3 n, 3 n) of all of them in
    this order; those of a reference body are 0. ``residual_px`` is the rms residual of each
    body, ``corner_px`` the standard deviation of a co-ordinate that the uncertainties use.
    ``other_rad`` is how much the angles would differ in the second pose that also fits.
    """

    plane: Array
    plane_covariance: Array
    names: tuple[str, ...]
    bodies: Array
    covariance: Array
    residual_px: tuple[float, ...]
    corner_px: float
    other: Array


def solve(bodies: Sequence[Body], camera: PoseCamera, reference: str = "") -> Solution:
    """Fit the plane and all bodies.

    Args:
        bodies: those that were found; the reference body must be among them.
        camera: with a plane, unless ``reference`` is given.
        reference: the body that is the origin; "" where the camera's plane is.

    Raises:
        NoSolution: no plane, or a body does not fit.
    """
    problem = _Problem(bodies, camera, reference)
    best, other = problem.fits()
    n = len(problem.bodies)
    s2 = problem.variance(best.residuals)
    inverse = np.linalg.pinv(problem.information(best, s2))
    covariance: Array = np.asarray(inverse, dtype=np.float64)
    values, spread = np.zeros((n, 3)), np.zeros((3 * n, 3 * n))
    apart = np.zeros((n, 3))
    for k, at in enumerate(problem.places):
        if at is None:
            continue
        values[k] = best.x[at : at + 3]
        if other is not None:
            apart[k] = other.x[at : at + 3] - values[k]
            apart[k, 2] = math.remainder(apart[k, 2], math.tau)
        for m, beside in enumerate(problem.places):
            if beside is not None:
                block = covariance[at : at + 3, beside : beside + 3]
                spread[3 * k : 3 * k + 3, 3 * m : 3 * m + 3] = block
    residuals = tuple(float(np.sqrt(np.mean(part**2))) for part in problem.by_body(best.residuals))
    for body, rms in zip(problem.bodies, residuals, strict=True):
        if rms > LARGEST_RESIDUAL_PX:
            raise NoSolution(
                f"the corners of {body.name} lie {rms:.2f} pixels beside where a flat mark of the "
                "stated size would have them"
            )
    return Solution(
        best.x[:6], covariance[:6, :6], tuple(b.name for b in problem.bodies), values, spread,
        residuals, math.sqrt(s2), apart,
    )  # fmt: skip


@dataclass(frozen=True)
class _Fit:
    x: Array
    residuals: Array
    jacobian: Array


class _Problem:
    """Parameters: plane (6), then x, y, angle of each body but the reference."""

    def __init__(self, bodies: Sequence[Body], camera: PoseCamera, reference: str) -> None:
        self.camera = camera
        self.bodies = list(bodies)
        names = [body.name for body in bodies]
        if camera.plane is None and reference not in names:
            raise NoSolution("neither the calibration nor a reference mark gives the plane")
        self.origin = names.index(reference) if camera.plane is None else None
        self.places: list[int | None] = []
        at = 6
        for k in range(len(bodies)):
            self.places.append(None if k == self.origin else at)
            at += 0 if k == self.origin else 3
        self.size = at
        self.seen = [np.asarray(body.pixels, dtype=np.float64) for body in bodies]
        self.weights = None
        if camera.plane is not None:
            covariance = np.array(camera.plane.covariance)
            self.weights = np.linalg.inv(np.linalg.cholesky(covariance))

    def fits(self) -> tuple[_Fit, _Fit | None]:
        """The best fit, and the second pose of the plane where it fits nearly as well."""
        fits = (self._fit(start) for start in self._starts())
        found = sorted(fits, key=lambda fit: float(fit.residuals @ fit.residuals))
        best = found[0]
        for fit in found[1:]:
            more = float(fit.residuals @ fit.residuals - best.residuals @ best.residuals)
            if more < 9.0 * self.variance(best.residuals):
                return best, fit
        return best, None

    def variance(self, residuals: Array) -> float:
        """Variance of one co-ordinate of a corner in pixels squared."""
        freedom = max(0, len(residuals) - self.size + (6 if self.weights is not None else 0))
        squares = float(residuals @ residuals)
        noise2 = sum(body.noise_px**2 for body in self.bodies) / len(self.bodies)
        known = CORNER_FREEDOM * (CORNER_PX**2 + noise2)
        return (squares + known) / (freedom + CORNER_FREEDOM)

    def information(self, fit: _Fit, variance: float) -> Array:
        """Inverse of the covariance of all parameters."""
        out: Array = fit.jacobian.T @ fit.jacobian / variance
        if self.weights is not None:
            out[:6, :6] += self.weights.T @ self.weights
        return out

    def by_body(self, residuals: Array) -> list[Array]:
        """Residuals of each body."""
        ends = np.cumsum([2 * len(body.points) for body in self.bodies])
        return list(np.split(residuals, ends[:-1]))

    def _starts(self) -> list[Array]:
        import cv2

        if self.camera.plane is not None:
            return [self._with_bodies(np.array(self.camera.plane.pose))]
        assert self.origin is not None
        body = self.bodies[self.origin]
        poses = cv2.solvePnPGeneric(
            body.points, self.seen[self.origin], self.camera.matrix, None,
            flags=cv2.SOLVEPNP_IPPE,
        )  # fmt: skip
        out = []
        for turn, shift in zip(poses[1], poses[2], strict=True):
            pose = np.concatenate([np.ravel(turn), np.ravel(shift)])
            if np.isfinite(pose).all() and pose[5] > 0.0:
                out.append(self._with_bodies(pose))
        if not out:
            raise NoSolution(f"the corners of {body.name} are those of no mark before the camera")
        return out

    def _with_bodies(self, pose: Array) -> Array:
        """A start from the pose of the plane: each body by its corners laid onto the plane."""
        import cv2

        start = np.zeros(self.size)
        start[:6] = pose
        turn = cv2.Rodrigues(pose[:3])[0]
        inverse = np.linalg.inv(self.camera.matrix)
        for body, seen, at in zip(self.bodies, self.seen, self.places, strict=True):
            if at is None:
                continue
            rays = (turn.T @ inverse @ np.column_stack([seen, np.ones(len(seen))]).T).T
            eye = -turn.T @ pose[3:]
            depth = (float(body.points[0, 2]) - eye[2]) / rays[:, 2]
            flat = eye[:2] + rays[:, :2] * depth[:, None]
            own = body.points[:, :2]
            a, b = own - own.mean(axis=0), flat - flat.mean(axis=0)
            angle = math.atan2(
                float(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])), float(np.sum(a * b))
            )
            c, s = math.cos(angle), math.sin(angle)
            middle = flat.mean(axis=0) - np.array([[c, -s], [s, c]]) @ own.mean(axis=0)
            start[at : at + 3] = (*middle, angle)
        return start

    def _residuals(self, x: Array) -> Array:
        import cv2

        turn = cv2.Rodrigues(x[:3])[0]
        parts = []
        for body, seen, at in zip(self.bodies, self.seen, self.places, strict=True):
            points = body.points
            if at is not None:
                c, s = math.cos(x[at + 2]), math.sin(x[at + 2])
                spin = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
                points = points @ spin.T + [x[at], x[at + 1], 0.0]
            before = points @ turn.T + x[3:6]
            u = self.camera.fx * before[:, 0] / before[:, 2] + self.camera.cx
            v = self.camera.fy * before[:, 1] / before[:, 2] + self.camera.cy
            parts.append((np.column_stack([u, v]) - seen).ravel())
        return np.concatenate(parts)

    def _fit(self, start: Array) -> _Fit:
        """Levenberg and Marquardt, as MINPACK has it."""
        from scipy.optimize import least_squares

        corners = CORNER_PX if self.weights is not None else 1.0
        plane = None if self.camera.plane is None else np.array(self.camera.plane.pose)

        def rest(x: Array) -> Array:
            residuals = self._residuals(x)
            if plane is None or self.weights is None:
                return residuals
            return np.concatenate([residuals / corners, self.weights @ (x[:6] - plane)])

        scale = np.ones(self.size)
        scale[3:6] = max(1.0, float(np.abs(start[3:6]).max()))
        scale[:3] = 0.1
        found = least_squares(rest, start, x_scale=scale, method="lm", jac="2-point")
        residuals = self._residuals(found.x)
        jacobian = np.asarray(found.jac)[: len(residuals)] * corners
        return _Fit(np.asarray(found.x), residuals, jacobian)
