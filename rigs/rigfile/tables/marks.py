"""Files for the pose of marks: which marks to measure, and the calibrated camera."""

from __future__ import annotations

import importlib.resources
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from daq.calibration import MOST_DAYS, Calibration
from daq.errors import ConfigError
from daq.wholefile import write_whole
from plant import tomlfile
from rigs.rigfile.device import Device
from rigs.rigfile.toml_reader import Table
from vision.pose.camera import PoseCamera
from vision.pose.detect import DICTIONARIES, Board
from vision.pose.measure import Mark, MarkSettings

MARK_NAME = "letters, digits and _"
SHIPPED = "marks"
"""Folder of `configs` with files of marks."""


@dataclass(frozen=True)
class MarkForm:
    """What a mark in pictures measures: the angle of its link, so many pictures a second."""

    rate_hz: float
    quantity: str = "angle_deg"
    unit: str = "deg"


@dataclass(frozen=True)
class MarkDevice(Device):
    """The angle of one mark in the pictures of the camera of the rig, as an instrument.

    Attributes:
        mark: its name in the file of marks.
        form, calibration: from the angle of the mark to that of the joint, in degrees.
    """

    mark: str
    form: MarkForm
    calibration: Calibration


def read_mark_device(t: Table) -> MarkDevice:
    """A table ``[instruments.NAME]`` with ``protocol = "marks"``.

    Raises:
        ConfigError: names file and key.
    """
    zero_deg = t.number("zero_deg", -360, 360, 0.0, unit="degree")
    direction = t.integer("direction", -1, 1, 1)
    if direction == 0:
        raise t.fail("direction", "is 1 or -1")
    out = MarkDevice(
        "", 0, "",
        mark=t.text("mark"),
        form=MarkForm(t.number("rate_hz", 4, 200, 10.0, unit="1/s")),
        calibration=Calibration(
            quantity="angle_deg",
            unit="deg",
            raw_unit="deg",
            offset=zero_deg,
            scale=float(direction),
            u_offset=t.number("u_offset", 0, 1e6, 0.0),
            u_gain=t.number("u_gain", 0, 1, 0.0),
            domain=(-720.0, 720.0),
            id=t.text("id", "as the manufacturer states"),
            date=t.text("date", ""),
            valid_days=t.integer("valid_days", 0, MOST_DAYS, 0),
        ),
    )  # fmt: skip
    t.finish()
    return out


def marks_file(name: str, source: str) -> Path:
    """The file of marks that a rig file names: one beside it, or a shipped one by its name.

    Raises:
        ConfigError: there is no shipped one of that name.
    """
    if name.endswith(".toml"):
        return Path(source).parent / name
    shipped = importlib.resources.files("configs") / SHIPPED
    path = Path(str(shipped)) / f"{name}.toml"
    if not path.is_file():
        raise ConfigError(
            f"{source}: camera.marks", f"there is no shipped file of marks {name!r}",
            "name a file beside the rig file: marks.toml",
        )  # fmt: skip
    return path


def load_marks(path: Path) -> MarkSettings:
    """Read a file of marks (TOML) and the camera calibration that it names.

    Raises:
        ConfigError: names file and key of what is missing, unknown or impossible.
    """
    root = Table(_toml(path, "write one as docs/use/pose.md shows"), str(path))
    dictionary = root.text("dictionary", "4x4_50", choices=tuple(DICTIONARIES))
    camera = load_pose_camera(path.parent / root.text("camera"))
    reference = root.text("reference", "")
    tables = root.table("marks")
    marks = tuple(_mark(tables.table(name), name, dictionary) for name in tables.keys())  # noqa: SIM118
    root.finish()
    settings = MarkSettings(marks, camera, reference, dictionary)
    try:
        settings.check()
    except ValueError as error:
        raise ConfigError(str(path), str(error)) from None
    return settings


def _mark(t: Table, name: str, dictionary: str) -> Mark:
    if not name.isidentifier():
        raise t.fail(name, f"a name of a mark has {MARK_NAME}")
    height = t.number("height_mm", -1000, 1000, 0.0, unit="mm")
    turned = t.number("turned_deg", -360, 360, 0.0, unit="degree")
    if "board" in t:
        size = t.numbers("board", 2, 100, least=2)
        if len(size) != 2 or any(v != int(v) for v in size):
            raise t.fail("board", f"expected [columns, rows] in squares, got {list(size)}")
        square = t.number("square_mm", 0.1, 1000, unit="mm")
        board = Board(
            int(size[0]), int(size[1]), square, t.number("mark_mm", 0.05, 0.95 * square, unit="mm"),
            dictionary, t.integer("first_id", 0, 999, 0),
        )  # fmt: skip
        mark = Mark(name, height_mm=height, turned_deg=turned, board=board)
    else:
        number, side = t.integer("id", 0, 999), t.number("side_mm", 0.1, 1000, unit="mm")
        mark = Mark(name, number, side, height, turned)
    t.finish()
    return mark


def load_pose_camera(path: Path) -> PoseCamera:
    """Read a camera calibration of `pamrig calibrate pose`.

    Raises:
        ConfigError: it cannot be read, or is none.
    """
    values = _toml(path, "make one with: pamrig calibrate pose")
    if set(values) != {"pose_camera"} or not isinstance(values["pose_camera"], dict):
        raise ConfigError(
            str(path), "expected one table [pose_camera]", "make one with: pamrig calibrate pose"
        )
    try:
        return PoseCamera.from_dict(values["pose_camera"])
    except (ValueError, KeyError, TypeError) as error:
        raise ConfigError(f"{path} [pose_camera]", str(error)) from None


def save_pose_camera(path: Path, camera: PoseCamera) -> None:
    """Write a camera calibration as TOML."""
    values = camera.to_dict()
    plane = values.pop("plane", None)
    lines = ["[pose_camera]", *(f"{key} = {_text(value)}" for key, value in values.items())]
    if plane is not None:
        lines += ["", "[pose_camera.plane]"]
        lines += [f"{key} = {_text(value)}" for key, value in plane.items()]
    write_whole(path, "\n".join(lines) + "\n")


def _text(value: Any) -> str:
    """A number or a list of numbers; both are written in JSON as in TOML."""
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"{value} cannot be written")
    return json.dumps(value)


def _toml(path: Path, remedy: str) -> dict[str, Any]:
    try:
        return tomlfile.loads(tomlfile.read_text(path))
    except (OSError, ValueError, RecursionError) as error:
        raise ConfigError(str(path), f"cannot be read: {error}", remedy) from None
