"""Stored pictures decoded and measured, live and in every later reduction alike."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from daq.errors import RecordError
from vision.decode import PictureError, decode_gray
from vision.gray import RegionError
from vision.marker.edge import measure_gap
from vision.marker.gap import GapMeasurement
from vision.marker.lens import Lens

if TYPE_CHECKING:
    from daq.store.run import Run

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
