"""The frames of a video file, one after the other."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from vision import MOST_PIXELS
from vision.decode import TOO_LARGE


class VideoError(ValueError):
    """The file is no video that can be read."""


class Video:
    """Frames of a video file as grey pictures, read when they are asked for.

    Raises:
        VideoError: it cannot be opened, holds no frame, or its frames are too large.
    """

    def __init__(self, path: Path) -> None:
        import cv2

        self._path = path
        self._video = self._opened()
        sides = (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)
        width, height = (float(self._video.get(side)) for side in sides)
        if width * height > MOST_PIXELS:
            self.close()
            raise VideoError(TOO_LARGE)
        if self.next() is None:
            self.close()
            raise VideoError("holds no frame that can be read")
        self.rewind()

    def rewind(self) -> None:
        """Begin anew with the first frame."""
        self.close()
        self._video = self._opened()

    def _opened(self) -> Any:
        import cv2

        video = cv2.VideoCapture(str(self._path))
        if not video.isOpened():
            video.release()
            raise VideoError("is no video that can be read (damaged, or cut short)")
        return video

    def next(self) -> npt.NDArray[np.uint8] | None:
        """The next frame (h, w); None after the last."""
        import cv2

        ok, image = self._video.read()
        if not ok or image is None:
            return None
        array = np.asarray(image)
        if array.ndim == 3:
            array = np.asarray(cv2.cvtColor(array, cv2.COLOR_BGR2GRAY))
        return np.ascontiguousarray(array, dtype=np.uint8)

    def close(self) -> None:
        """Close the file; may be called twice."""
        video, self._video = self._video, None
        if video is not None:
            video.release()
