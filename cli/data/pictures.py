"""Settings for the pictures of a recorded run: its own, or others for a derived version."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cli.options import bounded
from daq.errors import ConfigError, RecordError

if TYPE_CHECKING:
    from daq.store.run import Run
    from rigs.rigfile.camera_calibration import CameraCalibration
    from vision.marker.gap import GapMeasurement

Box = tuple[int, int, int, int]
METHODS = ("edge", "macro")
KNOWN = ("region", "method", "threshold", "flip", "calibration")


def parse_box(text: str, key: str = "--roi") -> Box:
    """``left,top,width,height`` as four whole numbers.

    Raises:
        ConfigError: the text is something else.
    """
    try:
        numbers = [int(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != 4 or min(numbers) < 0 or 0 in numbers[2:]:
        raise ConfigError(
            key,
            f"expected left,top,width,height in whole pixels, got {text!r}",
            "for example 10,300,500,70",
        )
    return numbers[0], numbers[1], numbers[2], numbers[3]


def vision_settings(given: list[str]) -> dict[str, Any]:
    """Settings such as ``region=10,300,500,70``, for :class:`daq.store.run.Run`.

    Raises:
        ConfigError: a setting is unknown, given twice, or has an impossible value.
    """
    camera: dict[str, Any] = {}
    out: dict[str, Any] = {"camera": camera}
    seen: set[str] = set()
    for text in given:
        name, found, value = (part.strip() for part in text.partition("="))
        if not found or name not in KNOWN or name in seen:
            what = "is given twice" if name in seen else "is no setting"
            raise ConfigError("--vision", f"{text!r} {what}", f"known: NAME=VALUE of {KNOWN}")
        seen.add(name)
        if name == "calibration":
            length, lens = _calibration(Path(value))
            out["length_mm"], camera["lens"] = length, lens
        else:
            camera[name] = _value(name, value)
    if camera.get("method") == "macro":
        camera.setdefault("region", None)
    elif extra := seen & {"threshold", "flip"}:
        raise ConfigError("--vision", f"{min(extra)} is one of the macro", "add method=macro")
    return out


def _value(name: str, text: str) -> Any:
    if name == "region":
        return None if text == "whole" else list(parse_box(text, "--vision region"))
    if name == "threshold":
        if not text.lstrip("-").isdecimal():
            raise ConfigError("--vision threshold", f"expected a whole number, got {text!r}")
        bounded("--vision threshold", int(text), 0, 255)
        return int(text)
    choices: dict[str, Any] = (
        {"yes": True, "no": False} if name == "flip" else {m: m for m in METHODS}
    )
    if text not in choices:
        raise ConfigError(f"--vision {name}", f"{text!r} is not one of {', '.join(choices)}")
    return choices[text]


def _calibration(path: Path) -> tuple[dict[str, Any], dict[str, float] | None]:
    from rigs.rigfile.camera_calibration import load_camera_calibration

    straight, lens = load_camera_calibration(path).frozen()
    return straight.to_dict(), lens


def recorded_run(source: str | Path, runs: Path) -> Run | None:
    """The run that a source of frames names by its folder or id; None if it names none.

    Raises:
        RecordError: several runs have that part of a name.
    """
    from daq.store.run import open_run
    from daq.store.store import find_run, list_runs

    text = str(source)
    if os.path.exists(text):
        return open_run(text) if (Path(text) / "run.json").is_file() else None
    names = [info.run_id for info in list_runs(runs)]
    if names and (text == "last" or any(text in name for name in names)):
        return find_run(runs, text)
    return None


@dataclass(frozen=True)
class OwnSettings:
    """How a run measured its pictures.

    Attributes:
        folder: of the run.
        camera: for ``measure_stored``; empty if run.json is damaged.
        calibration: that of the run; None if it has none.
    """

    folder: Path
    camera: dict[str, Any]
    calibration: CameraCalibration | None

    def measure(self, gray: Any, roi: Box | None) -> GapMeasurement:
        """As live and in the reduction; ``roi`` takes the place of the run's region.

        Raises:
            RegionError: ``roi`` does not lie inside the picture.
        """
        from analysis.reduction.pictures import measure_stored
        from vision.gray import RegionError

        if roi is None:
            return measure_stored(gray, self.camera)
        left, top, width, height = roi
        if left + width > gray.shape[1] or top + height > gray.shape[0]:
            size = f"{gray.shape[1]} x {gray.shape[0]} pixels"
            raise RegionError(f"the region {roi} does not lie inside the frame of {size}")
        return measure_stored(gray, {**self.camera, "region": list(roi)})


def own_settings(source: str | Path, runs: Path) -> OwnSettings | None:
    """The settings of the run that a source of frames names; None if it names none."""
    from analysis.reduction.pictures import camera_of
    from rigs.rigfile.camera_calibration import CameraCalibration

    run = recorded_run(source, runs)
    if run is None:
        return None
    try:
        camera, length = camera_of(run), run.calibrations.get("length_mm")
    except RecordError:  # run.json is damaged: its pictures are still pictures
        return OwnSettings(run.folder, {}, None)
    return OwnSettings(run.folder, camera, None if length is None else CameraCalibration(length))
