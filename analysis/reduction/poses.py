"""Poses of marks in the stored pictures of a run: measured again, as pictures of a length are."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING

from analysis.reduction.pictures import camera_of, decode, pose_of
from daq.errors import RecordError
from vision.pose.measure import MarkPose

if TYPE_CHECKING:
    from daq.store.run import Run


def frame_poses(run: Run, number: int) -> dict[str, MarkPose]:
    """The pose of every mark in one stored picture; a reason in each where it cannot be used.

    Raises:
        RecordError: the run has no marks, or their settings in run.json are invalid.
    """
    camera = camera_of(run)
    names = [m["name"] for m in (camera.get("marks") or {}).get("marks", ())]
    if not names:
        raise RecordError(str(run.folder / "run.json"), "states no marks", "see docs/use/pose.md")
    try:
        gray = decode(run.frame_bytes(number))
    except RecordError as error:
        return {name: MarkPose(name, reason=error.what) for name in names}
    if gray is None:
        why = "the stored picture cannot be decoded"
        return {name: MarkPose(name, reason=why) for name in names}
    found = pose_of(gray, camera)
    assert found is not None
    return found.poses


def point_poses(run: Run, frames: Iterable[int]) -> tuple[dict[str, float], list[str]]:
    """Means over the pictures of one point, of a link that rests.

    The uncertainty of a mean contains the scatter of the pictures. It is not below that of one
    picture, because in pictures of a link at rest the corners err in the same way.

    Returns:
        ``link_x_mm``, ``link_y_mm``, ``link_angle_deg`` of each mark (here ``link``), each with
        ``u_...``, nan where no picture gave it; and why pictures were left out.

    Raises:
        RecordError: as :func:`frame_poses`.
    """
    good: dict[str, list[MarkPose]] = {}
    left_out = []
    for number in frames:
        for name, pose in frame_poses(run, number).items():
            kept = good.setdefault(name, [])
            if pose.trusted:
                kept.append(pose)
            else:
                left_out.append(f"frame {number}, {name}: {pose.reason}")
    out: dict[str, float] = {}
    for name, poses in good.items():
        for quantity in ("x_mm", "y_mm", "angle_deg"):
            mean, u = still_mean(
                [getattr(p, quantity) for p in poses], [getattr(p, f"u_{quantity}") for p in poses],
                turns=quantity == "angle_deg",
            )  # fmt: skip
            out[f"{name}_{quantity}"], out[f"u_{name}_{quantity}"] = mean, u
    return out, left_out


def still_mean(values: list[float], us: list[float], turns: bool = False) -> tuple[float, float]:
    """Mean of what rests and its standard uncertainty; ``turns`` for angles in degrees."""
    if not values:
        return math.nan, math.nan
    off = [value - values[0] for value in values]
    if turns:
        off = [math.remainder(value, 360.0) for value in off]
    mean = sum(off) / len(off)
    scatter = math.sqrt(sum((v - mean) ** 2 for v in off) / max(1, len(off) - 1))
    return values[0] + mean, math.hypot(sum(us) / len(us), scatter / math.sqrt(len(off)))
