"""The angle of a mark in the pictures of a camera, as an instrument of the rig.

The camera is triggered at an even rate. Each picture is stored as a JPEG, and the stored picture is
measured, so that a later measurement of the record gives the same angle to the bit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from analysis.reduction.pictures import decode, pose_of
from daq.clock import NS_PER_S
from daq.errors import DeviceTimeout, PamrigError
from rigs.devices.camera import Frame, as_jpeg
from rigs.devices.event_loop import EventLoop
from rigs.devices.fresh_camera import FreshCamera
from rigs.devices.instruments.readings import COLUMNS as READING
from rigs.devices.instruments.readings import Batch, Readings
from rigs.rigfile.form import Parsed
from rigs.rigfile.tables.marks import MarkDevice

CONNECT_S = 3.0
NOT_STORED = -1
"""In the column ``frame``: a picture that was taken before the record began."""
COLUMNS = {**READING, "u_deg": "float64", "frame": "int64"}


class MarkReader(Readings):
    """One mark as an `Instrument` (`rigs.devices.interfaces`); its readings are in degrees.

    A picture without a certain pose is counted (``no_pose``) and gives no reading.

    Args:
        camera: of the rig.
        event_loop: of the bench.
        name: in the rig file.
        device: its table of the rig file.
        how: marks and camera (``rigs.rigfile.config.camera_values``).
        jpeg_quality: of the stored pictures.

    Attributes:
        keep: stores a picture and returns its number in the record; None before the record begins.
    """

    columns = COLUMNS

    def __init__(
        self,
        camera: FreshCamera,
        event_loop: EventLoop,
        name: str,
        device: MarkDevice,
        how: Mapping[str, Any],
        jpeg_quality: int,
    ) -> None:
        super().__init__(device.form.quantity, device.form.unit, device.calibration)
        self._camera = camera
        self._event_loop = event_loop
        self._mark = device.mark
        self._how = how
        self._quality = jpeg_quality
        self._period_ns = round(NS_PER_S / device.form.rate_hz)
        self._due_ns = 0
        self._busy = self._lost = False
        self._more: list[tuple[float, int]] = []
        self.key = name
        self.rate_hz = device.form.rate_hz
        self.identity: dict[str, str] = {}
        self.on_bytes: Callable[[int, bytes], None] | None = None
        self.keep: Callable[[Frame, bytes], int] | None = None

    @property
    def name(self) -> str:
        """Which mark."""
        return f"{self.key} (mark {self._mark} in the pictures of the camera)"

    @property
    def midway(self) -> bool:
        """Pictures come whole."""
        return False

    def connect(self, serial: str) -> dict[str, str]:
        """Check that the mark is seen; the camera checks its serial number.

        Raises:
            DeviceTimeout: no pose came.
        """
        del serial
        self.identity = {**self._camera.identity, "mark": self._mark}
        if not self._event_loop.until(lambda: self.rows > 0, CONNECT_S):
            raise DeviceTimeout(
                self.name, f"no pose within {CONNECT_S:g} s"
                + (f" (last: {self.faults.last})" if self.faults.last else ""),
                "check marks, light and lens; `pamrig pose` shows what it sees",
            )  # fmt: skip
        return self.identity

    def poll(self) -> None:
        """Take and measure a picture if one is due.

        While the camera is waited for the bench goes on, and this is called again: it then does
        nothing.

        Raises:
            DeviceError: once, when the camera is gone or gives no new picture.
        """
        now_ns = self._event_loop.clock.now_ns()
        if self._busy or self._lost or now_ns < self._due_ns:
            return
        self._due_ns = max(self._due_ns + self._period_ns, now_ns)
        self._busy = True
        try:
            self._look()
        except PamrigError as error:
            self._lost = True
            self.faults.add("unplugged", error.what)
            raise
        finally:
            self._busy = False

    def _look(self) -> None:
        """One picture: stored, decoded as it was stored, measured."""
        frame = self._camera.trigger()
        jpeg = as_jpeg(frame, self._quality)
        number = NOT_STORED if self.keep is None else self.keep(frame, jpeg)
        gray = decode(jpeg)
        assert gray is not None
        measured = pose_of(gray, self._how)
        assert measured is not None
        pose = measured.poses[self._mark]
        if not pose.trusted:
            self.faults.add("no_pose", pose.reason)
            return
        angle = pose.angle_deg
        if self.rows:  # a joint may turn beyond half a turn
            last = float(self.recent(1)[0][0])
            angle = last + math.remainder(angle - last, 360.0)
        self._more.append((pose.u_angle_deg, number))
        self._take(frame.host_ns, Parsed("", angle))
        self._hand_on()

    def _columns(self) -> Batch:
        u_deg, frame = zip(*self._more, strict=True)
        self._more.clear()
        return {"u_deg": np.array(u_deg, dtype=np.float64), "frame": np.array(frame, np.int64)}

    def finish(self) -> None:
        """Pictures come whole."""

    def next_mean(self, n: int) -> float:
        """Wait for ``n`` new readings and return their mean in ``quantity``.

        Raises:
            DeviceTimeout: they did not come.
        """
        start, seconds = self.rows, 3.0 * n / self.rate_hz + 1.0
        if not self._event_loop.until(lambda: self.rows >= start + n, seconds):
            raise DeviceTimeout(
                self.name, f"{self.rows - start} of {n} readings within {seconds:g} s",
                self.faults.last or "check marks, light and lens",
            )  # fmt: skip
        return self.mean(n)
