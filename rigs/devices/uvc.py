"""A USB camera read by a thread that stamps each frame as it comes in.

Reading in a thread keeps the driver's queue empty, so a frame is stamped when it arrives and
not when somebody gets round to it. The stamp is taken after the frame was exposed and moved;
the sync LED tells by how much (``vision.syncled``).
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from daq.clock import Clock
from daq.errors import DeviceError

PROPERTIES = {"width": 3, "height": 4, "fps": 5, "gain": 14, "exposure": 15, "focus": 28}
"""OpenCV's numbers of the properties (cv2.CAP_PROP_...)."""
AUTOMATIC = {"exposure": ((21, 1.0),), "focus": ((39, 0.0),)}
"""What switches the automatic off: CAP_PROP_AUTO_EXPOSURE manual (1 for V4L2), AUTOFOCUS 0."""
KEPT = 64  # frames between two calls of drain before the oldest go
STALE_READS = 5  # failed reads in a row before the camera counts as lost


@dataclass(frozen=True)
class UvcFrame:
    """One frame: the thread's count, the host's monotonic time of arrival, grey levels.

    ``repeated``: its grey levels are those of the frame before, to the last bit.
    """

    seq: int
    host_ns: int
    gray: npt.NDArray[np.uint8]
    repeated: bool = False


class UvcCamera:
    """A camera by index (0, 1, ...) or by URL or device path.

    ``settings`` are set before the first frame: width, height, fps, exposure, gain, focus, each
    in the driver's unit. With exposure or focus its automatic is switched off. ``applied`` has what
    the driver reports afterwards.

    ``dropped`` counts frames that nobody drained in time, ``repeated`` frames identical to
    the one before (a driver that hands out its buffer twice).

    Raises:
        DeviceError: there is no such camera, it is in use, it gives no frame, or it does not
            take a setting.
    """

    def __init__(
        self,
        index_or_url: int | str,
        clock: Clock,
        capture: Any = None,
        settings: Mapping[str, float] | None = None,
    ) -> None:
        self.name = f"camera {index_or_url}"
        self._clock = clock
        self.dropped = 0
        self.repeated = 0
        self._lock = threading.Lock()
        self._kept: deque[UvcFrame] = deque(maxlen=KEPT)
        self._newest: UvcFrame | None = None
        self._failure: DeviceError | None = None
        self._stop = threading.Event()
        if capture is None:
            import cv2

            # its own complaint on standard error says less than the DeviceError does
            logs = cv2.utils.logging
            logs.setLogLevel(logs.LOG_LEVEL_SILENT)
            capture = cv2.VideoCapture(index_or_url)
        self._capture = capture
        if not capture.isOpened():
            capture.release()
            raise DeviceError(
                self.name,
                "cannot be opened",
                "check that it is plugged in, that no other program uses it, and the key "
                "camera.source in the rig file",
            )
        self.applied = self._set(settings or {})
        first = self._read()
        if first is None:
            capture.release()
            raise DeviceError(
                self.name,
                "opens but gives no frame",
                "unplug it, plug it in again, try another mode",
            )
        self._keep(0, first)
        self._thread = threading.Thread(target=self._grab, name=self.name, daemon=True)
        self._thread.start()

    def _set(self, settings: Mapping[str, float]) -> dict[str, float]:
        """Set the camera and read back what it took."""
        for name, value in settings.items():
            for automatic, off in AUTOMATIC.get(name, ()):
                self._capture.set(automatic, off)
            self._capture.set(PROPERTIES[name], value)
        taken = {name: float(self._capture.get(PROPERTIES[name])) for name in settings}
        for name, value in settings.items():
            if abs(taken[name] - value) > max(0.01 * abs(value), 0.5):
                self._capture.release()
                raise DeviceError(
                    self.name,
                    f"does not take camera.settings.{name} = {value:g}: it reports {taken[name]:g}",
                    "use a value that the driver offers (Linux: v4l2-ctl --list-ctrls), or remove "
                    "the key",
                )
        return taken

    def _read(self) -> npt.NDArray[np.uint8] | None:
        ok, image = self._capture.read()
        if not ok or image is None:
            return None
        array = np.asarray(image)
        if array.ndim == 3 and array.shape[2] >= 3:
            import cv2

            array = np.asarray(cv2.cvtColor(array, cv2.COLOR_BGR2GRAY))
        elif array.ndim == 3:
            array = array[:, :, 0]
        return np.ascontiguousarray(array, dtype=np.uint8)

    def _keep(self, seq: int, gray: npt.NDArray[np.uint8]) -> None:
        now_ns = self._clock.now_ns()
        with self._lock:
            before = self._newest
            repeated = before is not None and np.array_equal(before.gray, gray)
            self.repeated += repeated
            frame = UvcFrame(seq, now_ns, gray, repeated)
            if len(self._kept) == KEPT:
                self.dropped += 1
            self._kept.append(frame)
            self._newest = frame

    def _grab(self) -> None:
        seq, failed = 1, 0
        while not self._stop.is_set():
            gray = self._read()
            if gray is None:
                failed += 1
                if failed >= STALE_READS:
                    with self._lock:
                        self._failure = DeviceError(
                            self.name,
                            f"gave no frame in {STALE_READS} reads after frame {seq - 1}",
                            "check its cable; start the run again",
                        )
                    return
                continue
            failed = 0
            self._keep(seq, gray)
            seq += 1

    def latest(self) -> UvcFrame | None:
        """The newest frame. Raises DeviceError once the camera is lost."""
        with self._lock:
            if self._failure is not None:
                raise self._failure
            return self._newest

    def drain(self) -> list[UvcFrame]:
        """All frames since the last call, oldest first. Raises DeviceError once it is lost."""
        with self._lock:
            frames = list(self._kept)
            self._kept.clear()
            if not frames and self._failure is not None:
                raise self._failure
        return frames

    def close(self) -> None:
        """Stop the thread and release the camera; may be called twice."""
        self._stop.set()
        thread = getattr(self, "_thread", None)
        if thread is not None and thread.is_alive():
            thread.join(timeout=2.0)
        self._capture.release()
