"""A camera's calibration: the straight part, the lens, the depth; and its file."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from daq.calibration import Calibration
from daq.errors import ConfigError
from daq.wholefile import write_whole
from plant import tomlfile
from vision.marker.gap import GapMeasurement
from vision.marker.lens import Lens


@dataclass(frozen=True)
class CameraCalibration:
    """The straight part (``calibration``), the lens, and what leaving the plane does.

    ``off_plane_per_mm`` is the relative change of the scale for each mm that the marks stand
    nearer to the camera than the calibrated plane; ``u_off_plane_mm`` how well they stand in
    that plane.
    """

    calibration: Calibration
    lens: Lens | None = None
    off_plane_per_mm: float = 0.0
    u_off_plane_per_mm: float = 0.0
    u_off_plane_mm: float = 0.0

    def length_mm(
        self, pixels: float, u_pixels: float, gap: GapMeasurement | None = None
    ) -> tuple[float, float, str]:
        """Length, its standard uncertainty, and a doubt where it lies outside the domain."""
        if self.lens is not None and gap is not None:
            pixels, u_pixels = self.lens.gap(gap)
        straight = self.calibration
        value = float(straight.apply(pixels))
        depth = self.off_plane_per_mm * self.u_off_plane_mm * (value - straight.offset)
        u = math.hypot(abs(straight.scale) * u_pixels, float(straight.u(value)), depth)
        doubt = ""
        if bool(straight.outside(value)):
            low, high = straight.domain
            doubt = (
                f"{value:.2f} mm is outside the calibration's domain {low:g} to {high:g} mm "
                f"({straight.id or 'no id'})"
            )
        return value, u, doubt

    def frozen(self) -> tuple[Calibration, dict[str, float] | None]:
        """The calibration with the depth in its gain, and the lens: as run.json holds them."""
        straight = self.calibration
        off = self.off_plane_per_mm * self.u_off_plane_mm
        lens = None if self.lens is None else {k: float(v) for k, v in vars(self.lens).items()}
        return replace(straight, u_gain=math.hypot(straight.u_gain, off)), lens

    def to_dict(self) -> dict[str, Any]:
        """For the calibration file and run.json."""
        out: dict[str, Any] = {"calibration": self.calibration.to_dict()}
        if self.lens is not None:
            out["lens"] = asdict(self.lens)
        out["off_plane"] = {
            "per_mm": self.off_plane_per_mm,
            "u_per_mm": self.u_off_plane_per_mm,
            "u_mm": self.u_off_plane_mm,
        }
        return out


def load_camera_calibration(path: Path) -> CameraCalibration:
    """Read a calibration file (TOML or JSON).

    Raises:
        ConfigError: it cannot be read, or a key is missing, unknown or impossible.
    """
    where = str(path)
    try:
        text = tomlfile.read_text(path)
        data = json.loads(text) if path.suffix.lower() == ".json" else tomlfile.loads(text)
    except (OSError, ValueError, RecursionError) as error:
        raise ConfigError(
            where, f"not a calibration file: {error}", "make one with: pamrig calibrate camera"
        ) from error
    if not isinstance(data, dict):
        raise ConfigError(where, "expected tables, got a list or value", "")
    if "calibration" not in data and "quantity" in data:
        data = {"calibration": data}
    unknown = sorted(set(data) - {"calibration", "lens", "off_plane"})
    if unknown or "calibration" not in data:
        raise ConfigError(
            where,
            f"unknown key {', '.join(unknown)}" if unknown else "missing table [calibration]",
            "known tables: calibration, lens, off_plane",
        )
    straight = Calibration.from_dict(data["calibration"], f"{where} [calibration]")
    if (straight.quantity, straight.raw_unit) != ("length_mm", "pixel"):
        raise ConfigError(
            f"{where} [calibration]",
            f"expected quantity length_mm from raw_unit pixel, got {straight.quantity} from "
            f"{straight.raw_unit}",
            "give the camera's calibration",
        )
    try:
        lens = Lens(**data["lens"]) if "lens" in data else None
        off = data.get("off_plane", {})
        return CameraCalibration(
            straight,
            lens,
            float(off.get("per_mm", 0.0)),
            float(off.get("u_per_mm", 0.0)),
            float(off.get("u_mm", 0.0)),
        )
    except (TypeError, ValueError) as error:
        raise ConfigError(f"{where} [lens] or [off_plane]", str(error), "") from error


def save_camera_calibration(path: Path, camera: CameraCalibration) -> None:
    """Write a calibration file; .json writes JSON, anything else TOML."""
    data = camera.to_dict()
    if path.suffix.lower() == ".json":
        write_whole(path, json.dumps(data, indent=1) + "\n")
        return
    lines: list[str] = []
    for table, values in data.items():
        lines.append(f"[{table}]")
        lines += [f"{key} = {_toml(value)}" for key, value in values.items()]
        lines.append("")
    write_whole(path, "\n".join(lines))


def _toml(value: Any) -> str:
    if isinstance(value, str):
        return json.dumps(value)
    if isinstance(value, list | tuple):
        ends = (-math.inf, math.inf)
        return (
            "["
            + ", ".join(_toml(e if v is None else v) for v, e in zip(value, ends, strict=True))
            + "]"
        )
    if isinstance(value, float):
        return {math.inf: "inf", -math.inf: "-inf"}.get(value, repr(value))
    return repr(value)
