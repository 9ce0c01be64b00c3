"""`pamrig length`: lengths from pictures, by the edge method or by the thesis's macro."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from daq.errors import ConfigError, PamrigError
from rigs.calibration.frames import FramesError, SourceFrame, open_frames
from rigs.rigfile.camera_calibration import CameraCalibration, load_camera_calibration

METHODS = ("edge", "macro")
MACRO_THRESHOLD = 130
MACRO_ROI = (10, 300, 500, 70)
MACRO_U_PIXELS = 1 / math.sqrt(12)  # whole pixels; a speck is not in it
Box = tuple[int, int, int, int]


@dataclass(frozen=True)
class LengthRow:
    """One frame's length, as `pamrig length --json` prints it; nan is printed as null."""

    file: str
    frame: int
    pixels: float
    u_pixels: float
    length_mm: float
    u_mm: float
    trusted: bool
    reason: str

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        out: dict[str, Any] = {"file": self.file, "frame": self.frame}
        for key in ("pixels", "u_pixels", "length_mm", "u_mm"):
            value = getattr(self, key)
            out[key] = value if math.isfinite(value) else None
        return out | {"trusted": self.trusted, "reason": self.reason}


def parse_box(text: str, key: str = "--roi") -> Box:
    """``left,top,width,height`` as four whole numbers.

    Raises:
        ConfigError: it is something else.
    """
    try:
        numbers = [int(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != 4 or numbers[2] < 1 or numbers[3] < 1:
        raise ConfigError(
            key,
            f"expected left,top,width,height in whole pixels, got {text!r}",
            "for example 10,300,500,70",
        )
    return numbers[0], numbers[1], numbers[2], numbers[3]


def measure_lengths(
    frames: str | Path,
    method: str = "edge",
    *,
    calibration: CameraCalibration | Path | None = None,
    threshold: int = MACRO_THRESHOLD,
    roi: Box | None = None,
    flip: bool = True,
    exclude: tuple[Box, ...] = (),
    preview: Path | None = None,
    count: int = 1,
) -> Iterator[LengthRow]:
    """Measure every frame of a source.

    Args:
        frames: picture, folder, TIFF stack, video, run folder, ``uvc:0`` or ``virtual:55``.
        method: ``edge`` or ``macro``.
        calibration: pixels to mm; None leaves length_mm and u_mm nan.
        threshold, roi, flip: the macro's parameters; roi is also the edge method's region
            (frame coordinates, not flipped), the whole frame when None.
        exclude: patches the edge method must not look at (the sync LED).
        preview: picture to write of the first frame measured.
        count: frames to take from a live camera.

    Raises:
        FramesError: no frames, or not pictures. ConfigError: a parameter. RecordError: a run.
    """
    if method not in METHODS:
        raise ConfigError("--method", f"expected edge or macro, got {method!r}", "use edge")
    if isinstance(calibration, Path):
        calibration = load_camera_calibration(calibration)
    drawn = preview is None
    for item in open_frames(frames, count=count):
        row, measured = _measure(item, method, threshold, roi, flip, exclude, calibration)
        if not drawn and item.image is not None and preview is not None:
            draw_preview(preview, item.image, method, measured, threshold, roi, flip, row)
            drawn = True
        yield row


def _measure(
    item: SourceFrame,
    method: str,
    threshold: int,
    roi: Box | None,
    flip: bool,
    exclude: tuple[Box, ...],
    calibration: CameraCalibration | None,
) -> tuple[LengthRow, Any]:
    from vision.gray import FrameError, RegionError

    nothing = (math.nan, math.nan, math.nan, math.nan, False)
    if item.image is None:
        return LengthRow(item.file, item.frame, *nothing, item.problem), None
    try:
        if method == "macro":
            from vision.macro import NoMarker, measure_macro

            try:
                index = measure_macro(item.image, threshold, roi or MACRO_ROI, flip)
            except NoMarker as error:
                return LengthRow(item.file, item.frame, *nothing, str(error)), None
            pixels, u_pixels, trusted, reason = index, MACRO_U_PIXELS, True, ""
            length, u, doubt = _to_mm(pixels, u_pixels, calibration, None)
            return (
                LengthRow(
                    item.file,
                    item.frame,
                    pixels,
                    u_pixels,
                    length,
                    u,
                    trusted and not doubt,
                    reason or doubt,
                ),
                None,
            )
        from vision.marker.edge import measure_gap

        gap = measure_gap(item.image, roi, exclude)
    except RegionError as error:
        raise ConfigError(
            f"{item.file}, --roi", str(error), "give left,top,width,height inside the frame"
        ) from error
    except FrameError as error:
        return LengthRow(item.file, item.frame, *nothing, str(error)), None
    length, u, doubt = _to_mm(gap.pixels, gap.u_pixels, calibration, gap)
    return (
        LengthRow(
            item.file,
            item.frame,
            gap.pixels,
            gap.u_pixels,
            length,
            u,
            gap.trusted and not doubt,
            gap.reason or doubt,
        ),
        gap,
    )


def _to_mm(
    pixels: float, u_pixels: float, calibration: CameraCalibration | None, gap: Any
) -> tuple[float, float, str]:
    if calibration is None or not math.isfinite(pixels):
        return math.nan, math.nan, ""
    return calibration.length_mm(pixels, u_pixels, gap)


def rows_as_json(rows: list[LengthRow]) -> str:
    """The list that `--json` prints."""
    return json.dumps([row.as_dict() for row in rows], indent=1)


def row_as_text(row: LengthRow) -> str:
    """One line for a person."""
    name = f"{row.file}[{row.frame}]"
    if not math.isfinite(row.pixels):
        return f"{name}: no length: {row.reason}"
    text = f"{name}: {row.pixels:.4f} px, u {row.u_pixels:.4f} px"
    if math.isfinite(row.length_mm):
        text += f"; {row.length_mm:.4f} mm, u {row.u_mm:.4f} mm"
    return text if row.trusted else f"{text}; not trusted: {row.reason}"


def length_report(
    frames: str | Path,
    method: str = "edge",
    calibration: Path | None = None,
    preview: Path | None = None,
    threshold: int = MACRO_THRESHOLD,
    roi: str = "",
    flip: bool = True,
    as_json: bool = False,
    count: int = 1,
) -> tuple[str, str]:
    """The body of `pamrig length`: what to print, and an error text or nothing.

    With the error text (no frame gave a length) the command prints both and exits with
    status 2.

    Raises:
        PamrigError: as measure_lengths, and for a calibration that cannot be read.
    """
    box = parse_box(roi) if roi else None
    rows = list(
        measure_lengths(
            frames,
            method,
            calibration=calibration,
            threshold=threshold,
            roi=box,
            flip=flip,
            preview=preview,
            count=count,
        )
    )
    if not rows:
        raise FramesError(str(frames), "holds no frame", "give a picture, folder, video or run")
    failed = ""
    if all(not math.isfinite(row.pixels) for row in rows) and (
        method == "macro" or any("read" in row.reason for row in rows)
    ):
        failed = str(PamrigError(str(frames), rows[0].reason, _remedy(method)))
    if as_json:
        return rows_as_json(rows), failed
    lines = [row_as_text(row) for row in rows]
    good = sum(row.trusted for row in rows)
    lines.append(f"{len(rows)} frame{'s' if len(rows) != 1 else ''}, {good} trusted")
    return "\n".join(lines), failed


def _remedy(method: str) -> str:
    if method == "macro":
        return "check --threshold and --roi against a --preview, or use --method edge"
    return "check that the files are pictures"


def draw_preview(
    path: Path,
    image: npt.NDArray[Any],
    method: str,
    measured: Any,
    threshold: int,
    roi: Box | None,
    flip: bool,
    row: LengthRow,
) -> None:
    """Write the preview of one frame. Raises ConfigError when it cannot be written."""
    from vision.marker.preview import draw

    try:
        draw(
            path,
            np.asarray(image),
            method=method,
            measured=measured,
            threshold=threshold,
            roi=roi or (MACRO_ROI if method == "macro" else None),
            flip=flip,
            title=row_as_text(row),
        )
    except (OSError, ValueError) as error:
        raise ConfigError(
            "--preview", f"cannot write {path}: {error}", "give a name that ends in .png"
        ) from error
