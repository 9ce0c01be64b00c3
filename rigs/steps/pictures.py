"""Pictures of the muscle: exposed, encoded, stored, and measured as they were stored."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from analysis.reduction.pictures import decode, measure_stored, pose_of
from daq.record.writer import RecordWriter
from rigs.bench.rig import Rig
from rigs.devices.camera import Frame, as_jpeg
from vision.marker.gap import GapMeasurement
from vision.pose.measure import PoseMeasurement

if TYPE_CHECKING:
    pass


@dataclass(frozen=True)
class Picture:
    """A stored picture: its number in the record, when it was taken, its bytes, its gap.

    ``pose`` has the marks, where the rig has any.
    """

    number: int
    host_ns: int
    jpeg: bytes
    gap: GapMeasurement
    pose: PoseMeasurement | None = None


def load_measuring(quality: int) -> None:
    """Load and compile all that measuring a picture needs, on a drawn one.

    This takes seconds the first time. Done before a record begins, it does not keep the loop that
    records from its work.
    """
    x = np.arange(640) + 0.5
    marks = sum(np.tanh(x - left) - np.tanh(x - left - 80) for left in (120.0, 420.0))
    noise = np.random.default_rng(1).normal(0.0, 2.0, (240, 640))
    gray = np.clip(180.0 - 70.0 * marks + noise, 0, 255).astype(np.uint8)
    ok, data = cv2.imencode(".jpg", gray, [cv2.IMWRITE_JPEG_QUALITY, quality])
    decoded = decode(data.tobytes()) if ok else None
    assert decoded is not None
    measure_stored(decoded, {})


def store(rig: Rig, record: RecordWriter, frame: Frame, **meta: Any) -> tuple[int, bytes]:
    """Encode a frame and append it to the record; its number and its bytes."""
    jpeg = as_jpeg(frame, rig.config.camera.jpeg_quality)
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
    pose = pose_of(gray, camera)
    if pose is not None:
        record.event("pose", frame=number, marks=pose.as_dict())
    return Picture(number, frame.host_ns, jpeg, gap, pose)
