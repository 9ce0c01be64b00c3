"""One picture of the muscle: exposed, encoded, stored, and measured as it was stored."""

from __future__ import annotations

import math

import cv2
import numpy as np

from daq.errors import DeviceError
from daq.record import RecordWriter
from rigs.rig import Rig
from vision.edge import GapMeasurement, measure_gap


def take_picture(rig: Rig, record: RecordWriter) -> tuple[int, GapMeasurement, bytes, int]:
    """Trigger, encode, store, decode, measure.

    The decoded JPEG is measured, not the frame as it came, so that a replay of the record
    gives the same length to the bit.

    Returns:
        (frame number in the record, measurement, JPEG bytes, host time in ns)
    """
    frame = rig.camera.trigger()
    ok, data = cv2.imencode(
        ".jpg", frame.gray, [cv2.IMWRITE_JPEG_QUALITY, rig.config.camera.jpeg_quality]
    )
    if not ok:
        raise DeviceError("camera", f"frame {frame.seq} cannot be encoded as JPEG")
    jpeg = data.tobytes()
    number = record.frame(jpeg, frame.host_ns, seq=frame.seq)
    gray = cv2.imdecode(np.frombuffer(jpeg, dtype=np.uint8), cv2.IMREAD_GRAYSCALE)
    gap = measure_gap(np.asarray(gray, dtype=np.uint8))
    known = math.isfinite(gap.pixels)
    record.event(
        "length",
        frame=number,
        pixels=gap.pixels if known else None,
        u_pixels=gap.u_pixels if known else None,
        trusted=gap.trusted,
        reason=gap.reason,
    )
    return number, gap, jpeg, frame.host_ns
