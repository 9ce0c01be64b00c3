"""A camera whose every picture is a new one, whatever camera or driver does."""

from __future__ import annotations

import numpy as np

from daq.clock import Clock, Deadline
from daq.errors import DeviceError, DeviceTimeout, PamrigError
from rigs.devices.camera import Camera, Frame, is_lit
from rigs.devices.faults import Faults

AGAIN_S = 0.15
"""So long an old picture is requested again. Shorter than the controller's patience without a
heartbeat, so that a frozen camera ends a test in good order: a hung load is lowered, not let go."""
PAUSE_S = 0.005


class FreshCamera:
    """Stands before a camera and hands no picture out twice, and none of another size.

    A frozen camera, grabber or driver gives an old picture with its old number and stamp, or
    with new ones. Two pictures of a sensor that has noise are never alike to the last bit, so the
    grey levels show it. An old picture is counted and requested again. A camera that was
    put to another mode shows the same length in other pixels: that ends the test.

    Args:
        camera: the device.
        clock: that of the bench.
        noisy: whether the sensor has noise; without it (a simulated one may have none) only number
            and stamp tell.

    Attributes:
        faults: pictures that were refused (``repeated``, ``size``) or did not come
            (``no_answer``, ``unplugged``).
        unmeasured: pictures that a test looked at without storing them, and in which no length was
            found; the caller counts them.
    """

    def __init__(self, camera: Camera, clock: Clock, noisy: bool = True) -> None:
        self._camera = camera
        self._clock = clock
        self._noisy = noisy
        self._last: Frame | None = None
        self.identity = camera.identity
        self.faults = Faults()
        self.frames = 0
        self.unmeasured = 0

    def trigger(self) -> Frame:
        """A frame exposed after this call.

        Raises:
            DeviceError: none comes, one of another size, or the same one again and again.
        """
        deadline = Deadline(self._clock, AGAIN_S)
        while True:
            frame = self._take()
            why = self._old(frame)
            if not why:
                self._last = frame
                self.frames += 1
                return frame
            self.faults.add("repeated", f"frame {frame.seq}: {why}")
            if deadline.expired:
                raise DeviceError(
                    "camera",
                    f"hands out the same picture again and again ({why})",
                    "it is frozen: unplug it, plug it in again, then `pamrig doctor`",
                )
            self._clock.sleep(PAUSE_S)

    def _take(self) -> Frame:
        """The camera's next picture; one that does not come is counted."""
        try:
            frame = self._camera.trigger()
        except DeviceTimeout as error:
            self.faults.add("no_answer", error.what)
            raise
        except PamrigError as error:
            self.faults.add("unplugged", error.what)
            raise
        size, before = frame.gray.shape, self._last and self._last.gray.shape
        if before and size != before:
            what = f"{size[1]} x {size[0]} pixels, {before[1]} x {before[0]} before"
            self.faults.add("size", what)
            raise DeviceError(
                "camera", f"changed its mode: {what}", "set it back; a length in pixels hangs on it"
            )
        return frame

    def _old(self, frame: Frame) -> str:
        """Why this is the same picture twice, or nothing."""
        last = self._last
        if last is None:
            return ""
        if frame.seq == last.seq:
            return "its number is that of the one before"
        if frame.host_ns <= last.host_ns:
            return "its stamp is not later than that of the one before"
        # Where no light falls there may be no noise either; no length is found there anyway.
        if self._noisy and is_lit(frame.gray) and np.array_equal(frame.gray, last.gray):
            return "its grey levels are those of the one before, to the last bit"
        return ""

    def counters(self) -> dict[str, int]:
        """Pictures handed out, and how many were refused."""
        unmeasured = {"unmeasured": self.unmeasured} if self.unmeasured else {}
        return {"frames": self.frames, **unmeasured, **self.faults.counts}

    def close(self) -> None:
        """Let go of the device; may be called twice."""
        self._camera.close()
