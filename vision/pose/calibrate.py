"""Calibrates the camera of a pose by pictures of a ChArUco board."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from vision.pose.camera import Plane, PoseCamera
from vision.pose.detect import Board, find_board
from vision.pose.solve import Body, NoSolution, solve

Array = npt.NDArray[np.float64]

LEAST_VIEWS = 4
"""Pictures of the board for a calibration: each with a tilt of its own."""
LEAST_CORNERS = 8
LEAST_TILT_DEG = 10.0
"""A board that is only seen upright leaves focal length and distance unknown."""
SIGNIFICANT = 3.0
"""A coefficient of distortion is kept if it is larger than so many of its uncertainties."""
LARGEST_RMS_PX = 1.0
"""A fit with larger residuals is not one of this board."""


class CalibrationError(ValueError):
    """The pictures give no calibration; the text states why."""


def calibrate(
    pictures: Sequence[tuple[str, npt.NDArray[np.uint8]]],
    board: Board,
    plane: npt.NDArray[np.uint8] | None = None,
) -> PoseCamera:
    """Calibrate a camera by pictures of a ChArUco board (Zhang's method, as OpenCV has it).

    Args:
        pictures: names and grey pictures (h, w) of the board at different tilts, 4 or more.
        board: the board; it must be flat.
        plane: a picture of the board lying in the plane of motion, upright; None leaves the plane
            to a reference mark in each picture.

    Raises:
        CalibrationError: a picture of another size, too few pictures show the board, all are alike.
    """
    import cv2

    objects, images = _corners(pictures, board)
    height, width = pictures[0][1].shape
    flags = cv2.CALIB_FIX_K3
    rms, matrix, distortion, u, tilt = _fit(objects, images, (width, height), flags)
    if abs(distortion[1]) < SIGNIFICANT * u[5] or abs(distortion[1]) > 5.0:
        flags |= cv2.CALIB_FIX_K2
    if (np.abs(distortion[2:4]) < SIGNIFICANT * u[6:8]).all():
        flags |= cv2.CALIB_ZERO_TANGENT_DIST
    if flags != cv2.CALIB_FIX_K3:  # what the pictures do not show is left out
        rms, matrix, distortion, u, tilt = _fit(objects, images, (width, height), flags)
    if not (math.isfinite(rms) and rms <= LARGEST_RMS_PX):
        raise CalibrationError(
            f"the fit leaves {rms:.2f} pixels; check the size of the board and that it is flat"
        )
    if not (u[0] < 0.05 * matrix[0, 0] and u[1] < 0.05 * matrix[1, 1]):
        raise CalibrationError(
            f"the focal length is uncertain by {100 * u[0] / matrix[0, 0]:.0f} %: take "
            "more pictures at larger tilts"
        )
    if tilt < LEAST_TILT_DEG:
        raise CalibrationError(
            f"the board is tilted by {tilt:.0f} degrees at most: tilt it by 20 to 40 degrees to "
            "different sides"
        )
    camera = PoseCamera(
        float(matrix[0, 0]), float(matrix[1, 1]), float(matrix[0, 2]), float(matrix[1, 2]),
        tuple(float(v) for v in distortion[:5]), int(width), int(height), rms, len(images),
    )  # fmt: skip
    if plane is None:
        return camera
    return with_plane(camera, board, plane)


def _corners(
    pictures: Sequence[tuple[str, npt.NDArray[np.uint8]]], board: Board
) -> tuple[list[Any], list[Any]]:
    """Places on the board and pixels, of each picture that shows enough of it."""
    if not pictures:
        raise CalibrationError("there is no picture")
    height, width = pictures[0][1].shape
    objects: list[Any] = []
    images: list[Any] = []
    for name, gray in pictures:
        if gray.shape != (height, width):
            raise CalibrationError(
                f"{name} has {gray.shape[1]} x {gray.shape[0]} pixels, the first {width} x {height}"
            )
        places, corners = find_board(gray, board)
        if len(corners) >= LEAST_CORNERS:
            objects.append(np.column_stack([places, np.zeros(len(places))]).astype(np.float32))
            images.append(corners.astype(np.float32).reshape(-1, 1, 2))
    if len(images) < LEAST_VIEWS:
        raise CalibrationError(
            f"{len(images)} of {len(pictures)} pictures show {LEAST_CORNERS} or more corners of "
            f"the board; {LEAST_VIEWS} are needed"
        )
    return objects, images


def _fit(
    objects: list[Any], images: list[Any], size: tuple[int, int], flags: int
) -> tuple[float, Array, Array, Array, float]:
    """RMS residual, matrix, distortion, standard uncertainties of all, largest tilt in degrees."""
    import cv2

    found = cv2.calibrateCameraExtended(objects, images, size, None, None, flags=flags)
    upright = [abs(float(cv2.Rodrigues(turn)[0][2, 2])) for turn in found[3]]
    tilt = math.degrees(math.acos(min(1.0, *upright)))
    return float(found[0]), np.asarray(found[1]), np.ravel(found[2])[:5], np.ravel(found[5]), tilt


def with_plane(camera: PoseCamera, board: Board, picture: npt.NDArray[np.uint8]) -> PoseCamera:
    """The camera with the plane in which the board lies in a picture.

    Raises:
        CalibrationError: the board is not seen well enough.
    """
    places, corners = find_board(picture, board)
    if len(corners) < LEAST_CORNERS:
        raise CalibrationError(
            f"the picture of the plane shows {len(corners)} corners of the board, "
            f"{LEAST_CORNERS} are needed"
        )
    body = Body(
        "plane", np.column_stack([places, np.zeros(len(places))]), camera.undistorted(corners)
    )
    try:
        found = solve([body], camera, reference="plane")
    except NoSolution as error:
        raise CalibrationError(f"the picture of the plane: {error}") from None
    covariance = tuple(tuple(float(v) for v in row) for row in found.plane_covariance)
    return replace(camera, plane=Plane(tuple(float(v) for v in found.plane), covariance))
