"""Cameras behind one face: a frame on trigger, with the time of its exposure."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np
import numpy.typing as npt

from daq.clock import Deadline
from daq.errors import DeviceError, DeviceTimeout, LinkLost, PamrigError
from daq.store.run import Run, open_run
from plant import tomlfile
from rigs.devices.cameras.genicam import GenicamCamera
from rigs.devices.cameras.video import Video, VideoError
from rigs.devices.event_loop import EventLoop
from rigs.rigfile.config import REPLAY, CameraDevice
from vision.decode import PictureError, decode_gray
from vision.files import LARGEST_PICTURE, VIDEOS, picture_files

if TYPE_CHECKING:
    from rigs.devices.uvc import UvcCamera

TRIGGER_S = 2.0
REPLAY_S = 0.02
"""So long a picture from a folder or a run takes: that of 50 pictures a second."""
JPEG_START = b"\xff\xd8\xff"


@dataclass(frozen=True)
class Frame:
    """One picture.

    ``gray`` is (h, w) uint8; ``host_ns`` the host's monotonic time of mid-exposure as far
    as the source can tell; ``seq`` the camera's own count; ``jpeg`` its bytes, where it comes as
    such: the record then keeps them as they are.
    """

    seq: int
    host_ns: int
    gray: npt.NDArray[np.uint8]
    jpeg: bytes = b""


def is_lit(gray: npt.NDArray[np.uint8]) -> bool:
    """Whether anything at all is in a picture, if only noise."""
    return int(gray.max()) > int(gray.min())


def as_jpeg(frame: Frame, quality: int) -> bytes:
    """The JPEG that is stored of a picture: as it came, or encoded.

    Raises:
        DeviceError: it cannot be encoded.
    """
    import cv2

    if frame.jpeg:
        return frame.jpeg
    ok, data = cv2.imencode(".jpg", frame.gray, [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not ok:
        raise DeviceError("camera", f"frame {frame.seq} cannot be encoded as JPEG")
    return data.tobytes()


class Camera(Protocol):
    """What a protocol needs of a camera."""

    identity: dict[str, str]

    def trigger(self) -> Frame:
        """A frame exposed after this call. Raises DeviceError when none comes."""
        ...

    def close(self) -> None:
        """Let go of the device; may be called twice."""
        ...


class CallCamera:
    """A camera that is a function: the virtual bench in the same process."""

    def __init__(self, expose: Callable[[], tuple[int, int, npt.NDArray[np.uint8]]], serial: str):
        self._expose = expose
        self.identity = {"serial": serial, "source": "virtual"}

    def trigger(self) -> Frame:
        """Render the bench as it is now."""
        return Frame(*self._expose())

    def close(self) -> None:
        """Nothing to release."""


class NoCamera:
    """In place of the camera in a rig that has none."""

    def __init__(self) -> None:
        self.identity: dict[str, str] = {}

    def trigger(self) -> Frame:
        """There is no picture."""
        raise DeviceError(
            "camera", "the rig has none", "add a table [camera], or a test without pictures"
        )

    def close(self) -> None:
        """Nothing to release."""


class TcpCamera:
    """The camera of `pamrig virtual`, on a loopback socket.

    Request ``I`` answers ``ID serial``; request ``T`` answers
    ``FRAME seq host_ns width height`` and the grey levels, row by row.
    """

    def __init__(self, source: str) -> None:
        host, _, port = source.removeprefix("tcp://").rpartition(":")
        self.name = f"camera on {source}"
        try:
            self._socket = socket.create_connection((host, int(port)), timeout=TRIGGER_S)
        except (OSError, ValueError) as error:
            raise DeviceError(
                self.name,
                f"cannot be opened: {error}",
                "start `pamrig virtual`, check camera.source",
            ) from None
        self._file = self._socket.makefile("rwb")
        answer = self._request(b"I\n").split()
        self.identity = {"serial": answer[1] if len(answer) > 1 else "", "source": source}

    def _request(self, request: bytes) -> str:
        try:
            self._file.write(request)
            self._file.flush()
            line = self._file.readline(200).decode("ascii", "replace").strip()
        except TimeoutError:
            raise DeviceTimeout(
                self.name, f"no answer within {TRIGGER_S:g} s", "restart it"
            ) from None
        except OSError as error:
            raise LinkLost(self.name, f"connection lost: {error}", "restart it") from None
        if not line:
            raise LinkLost(self.name, "connection closed by the other side", "restart it")
        return line

    def trigger(self) -> Frame:
        """Ask for a frame and wait for it."""
        words = self._request(b"T\n").split()
        if len(words) != 5 or words[0] != "FRAME":
            raise DeviceError(self.name, f"expected FRAME ..., got {' '.join(words)!r}")
        seq, host_ns, width, height = (int(w) for w in words[1:])
        if not (0 < width <= 8192 and 0 < height <= 8192):
            raise DeviceError(self.name, f"sent an impossible size {width} x {height}")
        data = self._file.read(width * height)
        if len(data) != width * height:
            raise LinkLost(self.name, "connection closed in mid-frame", "restart it")
        return Frame(seq, host_ns, np.frombuffer(data, dtype=np.uint8).reshape(height, width))

    def close(self) -> None:
        """Close the connection."""
        for thing in (self._file, self._socket):
            with contextlib.suppress(OSError):  # gone already, which is what we want
                thing.close()


class TriggeredUvc:
    """A free-running UVC camera used on trigger: the first frame stamped after the call.

    A frame that the driver hands out twice has a new stamp and is an old picture: it is passed
    over, unless it is all black, which no old picture need be the reason for. The bench goes on
    while it is waited for: a camera that hangs ends a test in good order.
    """

    def __init__(self, camera: UvcCamera, source: str, event_loop: EventLoop) -> None:
        self._camera = camera
        self._event_loop = event_loop
        applied = {name: f"{value:g}" for name, value in camera.applied.items()}
        self.identity = {"source": source, **applied}

    def trigger(self) -> Frame:
        """Wait for the next whole frame."""
        asked_ns = self._event_loop.clock.now_ns()
        deadline = Deadline(self._event_loop.clock, TRIGGER_S)
        while True:
            frame = self._camera.latest()
            if (
                frame is not None
                and frame.host_ns > asked_ns
                and not (frame.repeated and is_lit(frame.gray))
            ):
                return Frame(frame.seq, frame.host_ns, frame.gray)
            if deadline.expired:
                raise DeviceTimeout(
                    f"camera {self.identity['source']}",
                    f"no new frame within {TRIGGER_S:g} s",
                    "check its cable and that no other program uses it",
                )
            self._event_loop.step()

    def close(self) -> None:
        """Stop the grab thread and release the device."""
        self._camera.close()


class ReplayCamera:
    """Recorded pictures in place of a camera: those of a folder, or those stored in a run.

    Each trigger gives the next one, stamped with the time of the trigger. JPEG pictures go into
    the record as they are, so that their lengths are the same to the bit. Pictures that a run took
    of the sync LED are left out: their pattern is that of another time.

    Args:
        source: ``replay:`` and the path of a folder of pictures or a run.
        event_loop: of the bench, which goes on meanwhile.
        again: begin anew after the last picture; without it a further trigger is an error.
    """

    def __init__(self, source: str, event_loop: EventLoop, again: bool = False) -> None:
        self._event_loop = event_loop
        self._again = again
        self._given = 0
        self._name = f"camera ({source})"
        self._path = Path(source.removeprefix(REPLAY))
        self.identity = {"source": source}
        self._run: Run | None = None
        self._pictures: list[int] | list[Path] = []
        try:
            if (self._path / "run.json").is_file():
                self._run = open_run(self._path)
                self._pictures = [int(f["frame"]) for f in self._run.frames if not f.get("sync")]
                self.identity["run_id"] = self._run.run_id
            else:
                self._pictures = picture_files(self._path)
        except OSError as error:
            what = f"cannot be read: {error.strerror}"
            raise DeviceError(self._name, what, "check camera.source in the rig file") from None
        if not self._pictures:
            raise DeviceError(self._name, "holds no picture", "check camera.source in the rig file")
        self.identity["pictures"] = str(len(self._pictures))

    def trigger(self) -> Frame:
        """The next picture. Raises DeviceError if there is none, or it cannot be decoded."""
        number = len(self._pictures)
        if self._given >= number and not self._again:
            raise DeviceError(
                self._name, f"its {number} pictures are used up",
                "record more, or set camera.repeat = true",
            )  # fmt: skip
        self._event_loop.for_seconds(REPLAY_S)
        which = self._pictures[self._given % number]
        try:
            if isinstance(which, Path):
                data = tomlfile.read_bytes(which, LARGEST_PICTURE)
            else:
                assert self._run is not None
                data = self._run.frame_bytes(which)
            gray = decode_gray(data, eight_bit=True)
        except (OSError, PictureError, PamrigError) as error:
            name = which.name if isinstance(which, Path) else f"frame {which}"
            raise DeviceError(self._name, f"{name} cannot be read: {error}") from None
        self._given += 1
        jpeg = data if data.startswith(JPEG_START) else b""
        return Frame(self._given, self._event_loop.clock.now_ns(), gray, jpeg)

    def close(self) -> None:
        """Nothing to release."""


class ReplayVideo:
    """A recorded video in place of a camera: each trigger gives the next frame.

    Args:
        source: ``replay:`` and the path of a video file.
        event_loop: of the bench, which goes on meanwhile.
        again: begin anew after the last frame; without it a further trigger is an error.
    """

    def __init__(self, source: str, event_loop: EventLoop, again: bool = False) -> None:
        self._event_loop = event_loop
        self._again = again
        self._given = 0
        self._name = f"camera ({source})"
        self.identity = {"source": source}
        path = Path(source.removeprefix(REPLAY))
        if not path.is_file():
            raise DeviceError(self._name, "no such file", "check camera.source in the rig file")
        try:
            self._video = Video(path)
        except VideoError as error:
            raise DeviceError(
                self._name, str(error), "check camera.source in the rig file"
            ) from None

    def trigger(self) -> Frame:
        """The next frame. Raises DeviceError if there is none."""
        self._event_loop.for_seconds(REPLAY_S)
        gray = self._video.next()
        if gray is None and self._again:
            try:
                self._video.rewind()
            except VideoError as error:
                raise DeviceError(self._name, str(error)) from None
            gray = self._video.next()
        if gray is None:
            raise DeviceError(
                self._name, f"its {self._given} frames are used up",
                "record more, or set camera.repeat = true",
            )  # fmt: skip
        self._given += 1
        return Frame(self._given, self._event_loop.clock.now_ns(), gray)

    def close(self) -> None:
        """Close the file."""
        self._video.close()


class TriggeredGenicam:
    """A GenICam camera: each trigger is its software trigger. The bench goes on meanwhile."""

    def __init__(self, camera: GenicamCamera, serial: str, event_loop: EventLoop) -> None:
        self._camera = camera
        self._event_loop = event_loop
        self._given = 0
        applied = {name: f"{value:g}" for name, value in camera.applied.items()}
        self.identity = {"source": f"genicam:{serial}", "serial": serial, **applied}

    def trigger(self) -> Frame:
        """Request a picture and wait for it. Its time is that of the request."""
        clock = self._event_loop.clock
        self._camera.request()
        asked_ns = clock.now_ns()
        deadline = Deadline(clock, TRIGGER_S)
        while True:
            gray = self._camera.fetch(0.0)
            if gray is not None:
                self._given += 1
                return Frame(self._given, asked_ns, gray)
            if deadline.expired:
                raise DeviceTimeout(
                    f"camera {self.identity['source']}",
                    f"no picture within {TRIGGER_S:g} s",
                    "check its cable and that no other program uses it",
                )
            self._event_loop.step()

    def close(self) -> None:
        """Stop and release the camera."""
        self._camera.close()


def open_camera(config: CameraDevice, event_loop: EventLoop) -> Camera:
    """Open a camera that is not part of an in-process bench; ``event_loop`` runs the bench.

    Raises:
        DeviceError: it cannot be opened, or is another one than the rig file names.
    """
    camera: Camera
    if config.source.startswith(REPLAY) and Path(config.source).suffix.lower() in VIDEOS:
        return ReplayVideo(config.source, event_loop, config.repeat)
    if config.source.startswith(REPLAY):
        return ReplayCamera(config.source, event_loop, config.repeat)
    if config.source.startswith("tcp:"):
        camera = TcpCamera(config.source)
    elif config.source.startswith("genicam:"):
        serial = config.source.removeprefix("genicam:")
        made = GenicamCamera(serial, config.gentl, config.settings)
        camera = TriggeredGenicam(made, serial, event_loop)
    else:
        from rigs.devices.uvc import UvcCamera

        index = config.source.removeprefix("uvc:")
        uvc = UvcCamera(
            int(index) if index.isdigit() else index, event_loop.clock, settings=config.settings
        )
        camera = TriggeredUvc(uvc, config.source, event_loop)
    got = camera.identity.get("serial", "")
    if config.serial and got and got != config.serial:
        camera.close()
        raise DeviceError(
            f"camera on {config.source}",
            f"key camera.serial: expected {config.serial}, got {got}",
            "connect the right camera, or change camera.serial in the rig file",
        )
    return camera
