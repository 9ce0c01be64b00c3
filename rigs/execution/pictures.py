"""Pictures of the muscle: exposed, encoded, stored, and measured as they were stored."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import numpy.typing as npt

from daq.errors import DeviceError, RecordError
from daq.record.writer import RecordWriter
from rigs.bench.rig import Rig
from rigs.devices.camera import Frame
from vision.decode import PictureError, decode_gray
from vision.gray import RegionError
from vision.lens import Lens
from vision.marker.edge import GapMeasurement, measure_gap

if TYPE_CHECKING:
    from daq.store.run import Run


@dataclass(frozen=True)
class Picture:
    """A stored picture: its number in the record, when it was taken, its bytes, its gap."""

    number: int
    host_ns: int
    jpeg: bytes
    gap: GapMeasurement


FARTHEST = 1e9
"""Pixels, or a lens's coefficients: beyond, squares and their products are no numbers."""


def decode(jpeg: bytes) -> npt.NDArray[np.uint8] | None:
    """Grey levels of a stored picture, (h, w); None if it is none, or a larger one than is read."""
    try:
        return decode_gray(jpeg, eight_bit=True)
    except PictureError:
        return None


def camera_of(run: Run) -> dict[str, Any]:
    """How a run's pictures are to be measured: what :func:`measure_stored` takes.

    Raises:
        RecordError: run.json says something else there.
    """
    camera = run.manifest.get("camera") or {}
    try:
        region, sync, lens = (camera.get(key) or {} for key in ("region", "sync", "lens"))
        boxes = (*region, *(patch := sync["patch"] if sync else []))
        sound = {len(region), len(patch)} <= {0, 4} and all(type(n) is int for n in boxes)
        sound = sound and all(type(x) in (int, float) for x in lens.values())
        near = all(abs(x) < FARTHEST for x in (*boxes, *lens.values()))
        if not (sound and near) or (lens and Lens(**lens).radius < 1.0):
            raise ValueError(f"{camera}"[:200])
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        where = str(run.folder / "run.json")
        raise RecordError(where, f"camera: not what a rig says of its camera ({error})") from error
    return {"region": region, "sync": sync, "lens": lens}


def measure_stored(gray: npt.NDArray[np.uint8], camera: Mapping[str, Any]) -> GapMeasurement:
    """Measure a decoded picture as the run's rig says (``camera`` of run.json).

    The live test, the reduction and the view all come through here. The gap is freed of the
    lens's distortion where the camera's calibration knows it. A picture too small for its region,
    or for any, gives an untrusted measurement without a region, whose reason says so.
    """
    # Compiled code takes an array that may not be written for another type and is compiled anew:
    # some seconds without a heartbeat, in the midst of a test, where a frame came off a socket.
    gray = np.require(gray, np.uint8, ["C", "W"])
    region, sync, lens = (camera.get(key) for key in ("region", "sync", "lens"))
    try:
        gap = measure_gap(
            gray,
            tuple(region) if region else None,
            exclude=(tuple(sync["patch"]),) if sync else (),
        )
    except RegionError as error:
        return GapMeasurement(math.nan, math.nan, False, str(error))
    if lens and gap.left is not None and gap.right is not None:
        pixels, u_pixels = Lens(**lens).gap(gap)
        gap = replace(gap, pixels=pixels, u_pixels=u_pixels)
    return gap


def store(rig: Rig, record: RecordWriter, frame: Frame, **meta: Any) -> tuple[int, bytes]:
    """Encode a frame and append it to the record; its number and its bytes."""
    quality = [cv2.IMWRITE_JPEG_QUALITY, rig.config.camera.jpeg_quality]
    ok, data = cv2.imencode(".jpg", frame.gray, quality)
    if not ok:
        raise DeviceError("camera", f"frame {frame.seq} cannot be encoded as JPEG")
    jpeg = data.tobytes()
    return record.frame(jpeg, frame.host_ns, seq=frame.seq, **meta), jpeg


def take_picture(rig: Rig, record: RecordWriter, camera: Mapping[str, Any]) -> Picture:
    """Trigger, encode, store, decode, measure.

    The decoded JPEG is measured, not the frame as it came, so that a replay of the record
    gives the same length to the bit.
    """
    frame = rig.camera.trigger()
    number, jpeg = store(rig, record, frame)
    gray = decode(jpeg)
    assert gray is not None
    gap = measure_stored(gray, camera)
    known = math.isfinite(gap.pixels)
    record.event(
        "length",
        frame=number,
        pixels=gap.pixels if known else None,
        u_pixels=gap.u_pixels if known else None,
        trusted=gap.trusted,
        reason=gap.reason,
    )
    return Picture(number, frame.host_ns, jpeg, gap)
