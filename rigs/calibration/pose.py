"""`pamrig calibrate pose`: camera and plane by pictures of a ChArUco board."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from daq.errors import ConfigError
from rigs.calibration.frames import open_frames
from vision.gray import FrameError, to_gray
from vision.pose.calibrate import CalibrationError, calibrate
from vision.pose.camera import PoseCamera
from vision.pose.detect import Board


def calibrate_pose(source: str, board: Board, plane: str = "") -> PoseCamera:
    """Calibrate by the pictures of a folder, stack or video, and the picture of the plane.

    Raises:
        FramesError: no pictures. ConfigError: they give no calibration.
    """
    pictures = [(name, gray) for name, gray in _grays(source) if gray is not None]
    flat = None
    if plane:
        name, flat = next(_grays(plane), ("", None))
        if flat is None:
            raise ConfigError(plane, f"{name} cannot be read", "give a picture of the board")
    try:
        return calibrate(pictures, board, flat)
    except CalibrationError as error:
        raise ConfigError(source, str(error), "see docs/use/pose.md") from None


def _grays(source: str) -> Iterator[tuple[str, npt.NDArray[np.uint8] | None]]:
    for item in open_frames(source):
        gray: npt.NDArray[np.uint8] | None = None
        if item.image is not None:
            try:
                gray = np.rint(to_gray(item.image)).astype(np.uint8)
            except FrameError:
                gray = None
        yield item.file, gray
