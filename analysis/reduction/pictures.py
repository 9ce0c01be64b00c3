"""Decoding and measurement of stored pictures, the same live and in every later reduction."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from daq.errors import RecordError
from vision.decode import PictureError, decode_gray
from vision.gray import RegionError
from vision.macro import ROI, THRESHOLD, NoMarker, measure_macro
from vision.marker.edge import measure_gap
from vision.marker.gap import GapMeasurement
from vision.marker.lens import Lens
from vision.pose.measure import MarkSettings, PoseMeasurement, measure_pose

if TYPE_CHECKING:
    from daq.store.run import Run

MAX_MAGNITUDE = 1e9
"""Limit of pixel positions and lens coefficients. Beyond it, products of squares overflow."""


def decode(jpeg: bytes) -> npt.NDArray[np.uint8] | None:
    """Grey levels of a stored picture, (h, w); None if it cannot be decoded or is too large."""
    try:
        return decode_gray(jpeg, eight_bit=True)
    except PictureError:
        return None


def camera_of(run: Run) -> dict[str, Any]:
    """The camera settings of a run for :func:`measure_stored`: region, sync and lens.

    In a derived version also the ``method`` ("edge" or "macro") and what the macro uses.

    Raises:
        RecordError: the camera settings in run.json are invalid.
    """
    camera = run.manifest.get("camera") or {}
    try:
        region, sync, lens = (camera.get(key) or {} for key in ("region", "sync", "lens"))
        boxes = (*region, *(patch := sync["patch"] if sync else []))
        sound = {len(region), len(patch)} <= {0, 4} and all(type(n) is int for n in boxes)
        sound = sound and all(type(x) in (int, float) for x in lens.values())
        near = all(abs(x) < MAX_MAGNITUDE for x in (*boxes, *lens.values()))
        if not (sound and near) or (lens and Lens(**lens).radius < 1.0):
            raise ValueError(f"{camera}"[:200])
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        where = str(run.folder / "run.json")
        raise RecordError(where, f"camera: invalid camera settings ({error})") from error
    chosen = {k: camera[k] for k in ("method", "threshold", "flip") if run.pictures and k in camera}
    if camera.get("marks"):
        try:
            MarkSettings.from_dict(camera["marks"])
        except ValueError as error:
            where = str(run.folder / "run.json")
            raise RecordError(where, f"camera: invalid settings of the marks ({error})") from None
        chosen["marks"] = camera["marks"]
    return {"region": region, "sync": sync, "lens": lens, **chosen}


def pose_of(gray: npt.NDArray[np.uint8], camera: Mapping[str, Any]) -> PoseMeasurement | None:
    """Pose of the marks of a decoded picture, by ``marks`` in ``camera`` of run.json.

    The live test, the reduction and `pamrig pose` use this function. None where the rig has none.
    """
    marks = camera.get("marks")
    if not marks:
        return None
    return measure_pose(gray, _settings(json.dumps(marks, sort_keys=True)))


@lru_cache(maxsize=4)
def _settings(marks: str) -> MarkSettings:
    return MarkSettings.from_dict(json.loads(marks))


def measure_stored(gray: npt.NDArray[np.uint8], camera: Mapping[str, Any]) -> GapMeasurement:
    """Measure a decoded picture with the run's camera settings (``camera`` of run.json).

    The live test, the reduction and the view all use this function. The gap is corrected for
    lens distortion if the calibration of the camera has it. A picture that is too small gives an
    untrusted measurement without a region; its reason states this.
    """
    region, sync, lens = (camera.get(key) for key in ("region", "sync", "lens"))
    if camera.get("method") == "macro":
        return _macro(gray, camera)
    try:
        gap = measure_gap(
            gray,
            tuple(region) if region else None,
            exclude=(_box(sync.get("patch")),) if sync else (),
        )
    except RegionError as error:
        return GapMeasurement(math.nan, math.nan, False, str(error))
    if lens and gap.left is not None and gap.right is not None:
        pixels, u_pixels = Lens(**lens).gap(gap)
        gap = replace(gap, pixels=pixels, u_pixels=u_pixels)
    return gap


def _box(given: Any) -> tuple[int, int, int, int]:
    """Left, top, width and height of the patch of the sync light.

    Raises:
        RecordError: run.json does not hold four numbers there.
    """
    four = isinstance(given, (list, tuple)) and len(given) == 4
    if not four or any(isinstance(v, bool) or not isinstance(v, (int, float)) for v in given):
        what = f"camera.sync.patch: expected four numbers, got {given!r:.60}"
        raise RecordError("run.json", what)
    return int(given[0]), int(given[1]), int(given[2]), int(given[3])


def _macro(gray: npt.NDArray[np.uint8], camera: Mapping[str, Any]) -> GapMeasurement:
    """The thesis's macro: whole pixels, with the resolution of one as uncertainty."""
    region = camera.get("region")
    try:
        pixels = measure_macro(
            gray, int(camera.get("threshold", THRESHOLD)), tuple(region) if region else ROI,
            bool(camera.get("flip", True)),
        )  # fmt: skip
    except (RegionError, NoMarker) as error:
        return GapMeasurement(math.nan, math.nan, False, str(error))
    return GapMeasurement(float(pixels), 1 / math.sqrt(12.0), True, "")
