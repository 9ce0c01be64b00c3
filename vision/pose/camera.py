"""The camera of a pose: a pinhole with lens distortion, and the plane in which the marks move."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Plane:
    """Where the plane of motion stands before the camera.

    ``pose`` is the rotation vector and the translation in mm (6 numbers) that take a point of the
    plane (x right, y up, z towards the camera) into the camera's axes (x right, y down, z away);
    ``covariance`` is theirs (6 x 6).
    """

    pose: tuple[float, ...]
    covariance: tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class PoseCamera:
    """Focal lengths and centre in pixels, distortion k1, k2, p1, p2, k3 (Brown), picture size.

    ``rms_px`` is the root mean square of the residuals of ``views`` pictures of the board.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...]
    width: int
    height: int
    rms_px: float = 0.0
    views: int = 0
    plane: Plane | None = None

    @property
    def matrix(self) -> Array:
        """The 3 x 3 matrix of the pinhole."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def undistorted(self, pixels: Array) -> Array:
        """Pixels (n, 2) as a lens without distortion would show them."""
        import cv2

        k = self.matrix
        points = np.asarray(pixels, dtype=np.float64).reshape(-1, 1, 2)
        return np.asarray(
            cv2.undistortPoints(points, k, np.array(self.distortion), None, k), dtype=np.float64
        ).reshape(-1, 2)

    def distorted(self, pixels: Array) -> Array:
        """The inverse of :meth:`undistorted`: where the lens shows these pixels, (n, 2)."""
        import cv2

        k, zero = self.matrix, np.zeros(3)
        rays = np.column_stack([pixels, np.ones(len(pixels))]) @ np.linalg.inv(k).T
        seen, _ = cv2.projectPoints(rays, zero, zero, k, np.array(self.distortion))
        return np.asarray(seen, dtype=np.float64).reshape(-1, 2)

    def to_dict(self) -> dict[str, Any]:
        """Plain values for a file and for run.json."""
        out: dict[str, Any] = {k: v for k, v in vars(self).items() if k != "plane"}
        out["distortion"] = list(self.distortion)
        if self.plane is not None:
            out["plane"] = {
                "pose": list(self.plane.pose),
                "covariance": [list(row) for row in self.plane.covariance],
            }
        return out

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> PoseCamera:
        """The camera from its plain values.

        Raises:
            ValueError: a key is missing, unknown or impossible.
        """
        given = dict(values)
        plane = given.pop("plane", None)
        try:
            camera = cls(
                **{
                    **given,
                    "distortion": tuple(float(v) for v in given["distortion"]),
                    "plane": None if plane is None else _plane(plane),
                }
            )
            numbers = (camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion)
            sound = all(math.isfinite(v) and abs(v) < 1e6 for v in numbers)
            sound = sound and min(camera.fx, camera.fy) > 1.0 and len(camera.distortion) == 5
            sound = sound and all(type(n) is int and 0 < n <= 1 << 14 for n in camera.size)
        except KeyError as error:
            raise ValueError(f"key {error} is missing") from None
        except TypeError as error:
            raise ValueError(str(error).replace("PoseCamera.__init__() ", "")) from None
        if not sound:
            raise ValueError("impossible focal length, centre, distortion or size")
        return camera

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of its pictures."""
        return self.width, self.height


def _plane(values: Mapping[str, Any]) -> Plane:
    pose = tuple(float(v) for v in values["pose"])
    covariance = np.asarray(values["covariance"], dtype=np.float64)
    if len(pose) != 6 or covariance.shape != (6, 6) or not np.isfinite(covariance).all():
        raise ValueError("plane: expected 6 numbers of a pose and their 6 x 6 covariance")
    if np.linalg.eigvalsh(covariance).min() <= 0.0:
        raise ValueError("plane: its covariance is not positive definite")
    return Plane(pose, tuple(tuple(float(v) for v in row) for row in covariance))
