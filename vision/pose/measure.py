"""Pose of the marks of one picture: found, checked, fitted; with its uncertainty or a reason."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from vision.pose.camera import PoseCamera
from vision.pose.detect import DICTIONARIES, Board, Found, find_board, find_marks
from vision.pose.sides import BadSide, crossings
from vision.pose.solve import Body, NoSolution, Solution, solve

LEAST_SIDE_PX = 20.0
"""Shorter sides of a mark: a square of its pattern has then fewer than 3 pixels."""
LEAST_CONTRAST = 25.0
"""Grey levels between the dark border of a mark and the light around it."""
LEAST_CORNERS = 4


@dataclass(frozen=True)
class Mark:
    """A mark on a rigid body: an ArUco mark by number, or a ChArUco board.

    ``side_mm`` is the side of the dark square. ``height_mm`` is how far it stands from the plane
    towards the camera. ``turned_deg`` is the angle of the mark where that of its body is 0; the
    measured angle is without it.
    """

    name: str
    number: int = 0
    side_mm: float = 0.0
    height_mm: float = 0.0
    turned_deg: float = 0.0
    board: Board | None = None


@dataclass(frozen=True)
class MarkSettings:
    """What to measure: the marks, the camera, and the mark from which positions count.

    ``reference`` is "" where positions count from the plane of the camera's calibration.
    """

    marks: tuple[Mark, ...]
    camera: PoseCamera
    reference: str = ""
    dictionary: str = "4x4_50"

    @property
    def measured(self) -> tuple[str, ...]:
        """Names of the marks whose pose is measured: all but the reference."""
        return tuple(mark.name for mark in self.marks if mark.name != self.reference)

    def to_dict(self) -> dict[str, Any]:
        """Plain values for run.json (``camera.marks``)."""
        marks = []
        for mark in self.marks:
            values = dict(vars(mark))
            values["board"] = None if mark.board is None else dict(vars(mark.board))
            marks.append(values)
        return {
            "dictionary": self.dictionary,
            "reference": self.reference,
            "marks": marks,
            "camera": self.camera.to_dict(),
        }

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> MarkSettings:
        """Settings from their plain values.

        Raises:
            ValueError: something is missing or impossible.
        """
        try:
            marks = tuple(
                Mark(**{**mark, "board": Board(**mark["board"]) if mark.get("board") else None})
                for mark in values["marks"]
            )
            out = cls(
                marks,
                PoseCamera.from_dict(values["camera"]),
                str(values.get("reference", "")),
                str(values.get("dictionary", "4x4_50")),
            )
        except (KeyError, TypeError, AttributeError) as error:
            raise ValueError(f"marks: {error}") from None
        out.check()
        return out

    def check(self) -> None:
        """Whether the marks can be told apart, and the plane is known.

        Raises:
            ValueError: they cannot, or it is not.
        """
        owners: dict[tuple[str, int], str] = {}
        names = [mark.name for mark in self.marks]
        if len(set(names)) < len(names) or not names:
            raise ValueError("marks: each needs a name of its own")
        for mark in self.marks:
            board = mark.board
            dictionary = self.dictionary if board is None else board.dictionary
            count = 1 if board is None else board.marks
            first = mark.number if board is None else board.first_id
            most = int(dictionary.split("_")[1]) if dictionary in DICTIONARIES else 0
            if not 0 <= first <= most - count:
                raise ValueError(
                    f"mark {mark.name}: {dictionary} has no numbers {first} to {first + count - 1}"
                )
            for number in range(first, first + count):
                other = owners.setdefault((dictionary, number), mark.name)
                if other != mark.name:
                    raise ValueError(f"marks {other} and {mark.name} both have number {number}")
        if self.reference and self.reference not in names:
            raise ValueError(f"reference: there is no mark {self.reference!r}")
        if not self.reference and self.camera.plane is None:
            raise ValueError("reference: name a mark, or calibrate the camera with its plane")


@dataclass(frozen=True)
class MarkPose:
    """Pose of one mark in one picture; nan where ``trusted`` is False and nothing was found.

    ``x_mm``, ``y_mm`` and ``angle_deg`` with their standard uncertainties; ``residual_px`` is the
    rms distance of its corners from the fit. ``reason`` states why a pose must not be used.
    """

    name: str
    x_mm: float = math.nan
    y_mm: float = math.nan
    angle_deg: float = math.nan
    u_x_mm: float = math.nan
    u_y_mm: float = math.nan
    u_angle_deg: float = math.nan
    residual_px: float = math.nan
    trusted: bool = False
    reason: str = ""

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON; nan becomes None."""
        return {
            key: None if isinstance(value, float) and not math.isfinite(value) else value
            for key, value in vars(self).items()
        }


@dataclass(frozen=True)
class PoseMeasurement:
    """All measured marks of one picture, and where their corners were seen (for a drawing)."""

    poses: dict[str, MarkPose]
    corners: dict[str, npt.NDArray[np.float64]]
    corner_px: float = math.nan

    def as_dict(self) -> dict[str, dict[str, Any]]:
        """The poses by name, as plain values for an event of the record."""
        return {name: pose.as_dict() for name, pose in self.poses.items()}


def measure_pose(gray: npt.NDArray[np.uint8], settings: MarkSettings) -> PoseMeasurement:
    """Pose of every mark but the reference.

    Args:
        gray: picture (h, w), 8 bits, of the size that the camera was calibrated with.
        settings: marks and camera.

    Returns:
        One pose for each of ``settings.measured``, with a reason where it must not be used. A mark
        that is missing, doubtful, or there twice has no pose; the others are not affected.
    """
    if (gray.shape[1], gray.shape[0]) != settings.camera.size:
        why = "the picture has {} x {} pixels, the calibration {} x {}".format(
            gray.shape[1], gray.shape[0], *settings.camera.size
        )
        return _none(settings, dict.fromkeys((m.name for m in settings.marks), why))
    bodies, reasons = _bodies(gray, settings)
    corners = {body.name: settings.camera.distorted(body.pixels) for body in bodies}
    lost = reasons.get(settings.reference)
    if lost:
        why = f"reference {settings.reference}: {lost}"
        return replace(_none(settings, dict.fromkeys(settings.measured, why)), corners=corners)
    if len(bodies) == (1 if settings.reference else 0):
        return replace(_none(settings, reasons), corners=corners)
    try:
        found = solve(bodies, settings.camera, settings.reference)
    except NoSolution as error:
        missing = {body.name: str(error) for body in bodies}
        return replace(_none(settings, {**missing, **reasons}), corners=corners)
    poses = _none(settings, reasons).poses
    for mark in settings.marks:
        if mark.name in found.names and mark.name != settings.reference:
            poses[mark.name] = _pose(mark, found, settings.reference)
    return PoseMeasurement(poses, corners, found.corner_px)


def _none(settings: MarkSettings, reasons: Mapping[str, str]) -> PoseMeasurement:
    poses = {n: MarkPose(n, reason=reasons.get(n, "not found")) for n in settings.measured}
    return PoseMeasurement(poses, {})


def _bodies(
    gray: npt.NDArray[np.uint8], settings: MarkSettings
) -> tuple[list[Body], dict[str, str]]:
    """The marks that can be used, and why the others cannot."""
    squares = int(settings.dictionary[0]) + 2
    single = [mark for mark in settings.marks if mark.board is None]
    found = find_marks(gray, settings.dictionary) if single else []
    bodies: list[Body] = []
    reasons: dict[str, str] = {}
    for mark in settings.marks:
        noise = 0.0
        if mark.board is not None:
            places, pixels = find_board(gray, mark.board)
            reason = "" if len(pixels) >= LEAST_CORNERS else f"{len(pixels)} corners of it found"
            pixels = settings.camera.undistorted(pixels) if len(pixels) else pixels
        else:
            mine = [f for f in found if f.number == mark.number]
            reason = _doubt(gray, mine)
            half = 0.5 * mark.side_mm
            places = half * np.array([[-1.0, 1.0], [1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]])
            pixels = np.empty((0, 2))
            if not reason:
                try:
                    pixels, noise = crossings(
                        gray, mine[0].corners, settings.camera.undistorted, squares
                    )
                except BadSide as error:
                    reason = str(error)
        if reason:
            reasons[mark.name] = reason
            continue
        points = np.column_stack([places, np.full(len(places), mark.height_mm)])
        bodies.append(Body(mark.name, points, pixels, noise))
    return bodies, reasons


def _doubt(gray: npt.NDArray[np.uint8], mine: list[Found]) -> str:
    """Why a mark must not be used; "" where it may."""
    if not mine:
        return "not found"
    if len(mine) > 1:
        return f"number {mine[0].number} is in the picture {len(mine)} times"
    corners = mine[0].corners
    sides = np.hypot(*(np.roll(corners, -1, axis=0) - corners).T)
    if sides.min() < LEAST_SIDE_PX:
        return f"a side has {sides.min():.0f} pixels, {LEAST_SIDE_PX:.0f} are needed"
    dark, light = _levels(gray, corners)
    if light - dark < LEAST_CONTRAST:
        return f"a contrast of {light - dark:.0f} grey levels, {LEAST_CONTRAST:.0f} are needed"
    return ""


def _levels(gray: npt.NDArray[np.uint8], corners: npt.NDArray[np.float64]) -> tuple[float, float]:
    """Median level on the dark border of a mark, and on the light around it."""
    middle = corners.mean(axis=0)
    out = []
    for factor in (0.88, 1.12):
        ring = middle + factor * (corners - middle)
        along = np.linspace(0.1, 0.9, 9)[:, None, None]
        points = (ring + along * (np.roll(ring, -1, axis=0) - ring)).reshape(-1, 2)
        columns = np.clip(np.rint(points[:, 0]).astype(int), 0, gray.shape[1] - 1)
        rows = np.clip(np.rint(points[:, 1]).astype(int), 0, gray.shape[0] - 1)
        out.append(float(np.median(gray[rows, columns])))
    return out[0], out[1]


def _pose(mark: Mark, found: Solution, reference: str) -> MarkPose:
    """The pose in the axes of the reference, or of the plane where there is none."""
    k = found.names.index(mark.name)
    x, y, angle = (float(v) for v in found.bodies[k])
    own = found.covariance[3 * k : 3 * k + 3, 3 * k : 3 * k + 3]
    other = found.other[k]
    if reference:
        m = found.names.index(reference)
        x0, y0, angle0 = (float(v) for v in found.bodies[m])
        c, s = math.cos(angle0), math.sin(angle0)
        dx, dy = x - x0, y - y0
        x, y, angle = c * dx + s * dy, -s * dx + c * dy, angle - angle0
        turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        by_reference = -turn.copy()
        by_reference[0, 2], by_reference[1, 2] = y, -x
        jacobian = np.hstack([turn, by_reference])
        which = [*range(3 * k, 3 * k + 3), *range(3 * m, 3 * m + 3)]
        own = jacobian @ found.covariance[np.ix_(which, which)] @ jacobian.T
    u = np.sqrt(np.maximum(np.diag(own), 0.0) + (0.5 * other) ** 2)
    degrees = math.degrees(math.remainder(angle - math.radians(mark.turned_deg), math.tau))
    return MarkPose(
        mark.name, x, y, degrees, float(u[0]), float(u[1]), math.degrees(float(u[2])),
        found.residual_px[k], True,
    )  # fmt: skip
