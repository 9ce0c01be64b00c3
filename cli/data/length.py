"""`pamrig length`: lengths from pictures, by the edge method or by the thesis's macro."""

from __future__ import annotations

import json
import math
import textwrap
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cli.data.pictures import METHODS, Box, OwnSettings, own_settings, parse_box
from cli.options import RUNS, JsonOption, RunsOption, bounded
from cli.progress import counting
from daq.errors import ConfigError, PamrigError

if TYPE_CHECKING:
    from rigs.calibration.frames import SourceFrame
    from rigs.rigfile.camera_calibration import CameraCalibration

MACRO_THRESHOLD = 130
MOST_LIVE_FRAMES = 100_000
MACRO_ROI = (10, 300, 500, 70)
MACRO_U_PIXELS = 1 / math.sqrt(12)  # resolution of whole pixels; does not cover specks


def length(
    frames: Annotated[
        str, typer.Argument(help="Picture, folder, TIFF stack, video, run folder or run id.")
    ],
    method: Annotated[str, typer.Option(help="edge or macro.")] = "edge",
    calibration: Annotated[Path | None, typer.Option(help="Camera calibration file.")] = None,
    preview: Annotated[
        Path | None, typer.Option(help="Write a picture of the measurement.")
    ] = None,
    threshold: Annotated[
        int, typer.Option(help="Macro: NIH grey level, 0 white to 255 black.")
    ] = MACRO_THRESHOLD,
    roi: Annotated[
        str, typer.Option(help="Region left,top,width,height (macro: after the flip).")
    ] = "",
    flip: Annotated[
        bool, typer.Option("--flip/--no-flip", help="Macro: flip horizontally.")
    ] = True,
    count: Annotated[int, typer.Option(help="Frames to take from a live camera.")] = 1,
    runs: RunsOption = RUNS,
    as_json: JsonOption = False,
) -> None:
    """Measure lengths in pictures; exit status 2 if no frame gave a length."""
    bounded("--threshold", threshold, 0, 255)
    bounded("--count", count, 1, MOST_LIVE_FRAMES)
    rows = measure_lengths(
        frames, method, calibration=calibration, threshold=threshold,
        roi=parse_box(roi) if roi else None, flip=flip, preview=preview, count=count,
        runs=runs,
    )  # fmt: skip
    failed = write_lengths(
        counting(rows, "frames measured"),
        str(frames),
        method,
        as_json,
        lambda part: typer.echo(part, nl=False),
    )
    if failed:
        typer.echo(f"pamrig: {failed}", err=True)
    raise typer.Exit(2 if failed else 0)


@dataclass(frozen=True)
class LengthRow:
    """The length of one frame, as `pamrig length --json` prints it; nan becomes null.

    `readable` is False where the frame could not be decoded, does not hold the region, or ended
    the measurement by an error; it is not printed.
    """

    file: str
    frame: int
    pixels: float = math.nan
    u_pixels: float = math.nan
    length_mm: float = math.nan
    u_mm: float = math.nan
    trusted: bool = False
    reason: str = ""
    readable: bool = True

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        out: dict[str, Any] = {"file": self.file, "frame": self.frame}
        for key in ("pixels", "u_pixels", "length_mm", "u_mm"):
            value = getattr(self, key)
            out[key] = value if math.isfinite(value) else None
        return out | {"trusted": self.trusted, "reason": self.reason}

    def as_text(self) -> str:
        """One line of text."""
        name = f"{self.file}[{self.frame}]"
        if not math.isfinite(self.pixels):
            return f"{name}: no length: {self.reason}"
        text = f"{name}: {self.pixels:.4f} px, u {self.u_pixels:.4f} px"
        if math.isfinite(self.length_mm):
            text += f"; {self.length_mm:.4f} mm, u {self.u_mm:.4f} mm"
        return text if self.trusted else f"{text}; not trusted: {self.reason}"


def measure_lengths(
    frames: str | Path,
    method: str = "edge",
    *,
    calibration: Path | None = None,
    threshold: int = MACRO_THRESHOLD,
    roi: Box | None = None,
    flip: bool = True,
    preview: Path | None = None,
    count: int = 1,
    runs: Path = RUNS,
) -> Iterator[LengthRow]:
    """Measure every frame of a source.

    Args:
        frames: picture, folder, TIFF stack, video, run folder, ``uvc:0`` or ``virtual:55``.
        method: ``edge`` or ``macro``.
        calibration: file that converts pixels to mm; None takes that of a recorded run, and
            leaves length_mm and u_mm of other pictures nan.
        threshold, roi, flip: the macro's parameters. The edge method also uses roi (frame
            coordinates, not flipped); None is the whole frame.
        preview: picture to write of the first frame that can be read.
        count: frames to take from a live camera.
        runs: folder of runs, where ``frames`` is a run id.

    Raises:
        FramesError: no frames, or not pictures. ConfigError: a parameter. RecordError: a run.
    """
    from rigs.calibration.frames import open_frames
    from rigs.rigfile.camera_calibration import load_camera_calibration

    if method not in METHODS:
        raise ConfigError("--method", f"expected edge or macro, got {method!r}", "use edge")
    to_mm = None if calibration is None else load_camera_calibration(calibration)
    if method == "macro":
        roi = roi or MACRO_ROI
    own = own_settings(frames, runs)
    if own is not None and calibration is None:
        to_mm = own.calibration
    for item in open_frames(frames if own is None else own.folder, count=count):
        row, gap = _measure(item, method, threshold, roi, flip, to_mm, own)
        if preview is not None and item.image is not None:
            _draw_preview(
                preview, item.image, method=method, measured=gap, threshold=threshold, roi=roi,
                flip=flip, title=row.as_text(),
            )  # fmt: skip
            preview = None
        yield row


def _measure(
    item: SourceFrame,
    method: str,
    threshold: int,
    roi: Box | None,
    flip: bool,
    calibration: CameraCalibration | None,
    own: OwnSettings | None = None,
) -> tuple[LengthRow, Any]:
    """The length in one frame, and what the edge method measured (None for the macro)."""
    from vision.gray import FrameError, RegionError
    from vision.macro import NoMarker, measure_macro
    from vision.marker.edge import measure_gap

    if item.image is None:
        return LengthRow(item.file, item.frame, reason=item.problem, readable=False), None
    gap = None
    try:
        if method == "macro":
            pixels: float = measure_macro(item.image, threshold, roi or MACRO_ROI, flip)
            u_pixels, trusted, reason = MACRO_U_PIXELS, True, ""
        else:
            if own is not None and calibration is own.calibration:
                gap = own.measure(item.image, roi)
            else:
                gap = measure_gap(item.image, roi)
            pixels, u_pixels, trusted, reason = gap.pixels, gap.u_pixels, gap.trusted, gap.reason
    except (FrameError, NoMarker) as error:
        return LengthRow(item.file, item.frame, reason=str(error)), None
    except RegionError as error:
        return LengthRow(item.file, item.frame, reason=str(error), readable=False), None
    except Exception as error:  # a defect of the method must not end a folder of thousands
        reason = f"the measurement failed ({type(error).__name__}: {error})"
        return LengthRow(item.file, item.frame, reason=reason, readable=False), None
    length, u, doubt = math.nan, math.nan, ""
    if calibration is not None and math.isfinite(pixels):
        length, u, doubt = calibration.length_mm(pixels, u_pixels, gap)
    row = LengthRow(
        item.file, item.frame, pixels, u_pixels, length, u, trusted and not doubt, reason or doubt
    )
    return row, gap


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
    runs: Path = RUNS,
) -> tuple[str, str]:
    """The output of `pamrig length`, and an error text ("" if a frame gave a length).

    Raises:
        PamrigError: as measure_lengths, and for a calibration that cannot be read.
    """
    rows = measure_lengths(
        frames, method, calibration=calibration, threshold=threshold,
        roi=parse_box(roi) if roi else None, flip=flip, preview=preview, count=count,
        runs=runs,
    )  # fmt: skip
    parts: list[str] = []
    failed = write_lengths(rows, str(frames), method, as_json, parts.append)
    return "".join(parts).rstrip("\n"), failed


def write_lengths(
    rows: Iterable[LengthRow],
    source: str,
    method: str,
    as_json: bool,
    write: Callable[[str], object],
) -> str:
    """Write each row as soon as it is there; returns an error text ("" if a frame gave a length).

    What was written is whole JSON even if the source fails midway.

    Raises:
        FramesError: there is no row at all. PamrigError: as the source of the rows.
    """
    count = trusted = 0
    found = False
    first: LengthRow | None = None  # the first row, or the first that could not be read
    try:
        for row in rows:
            text = row.as_text()
            if as_json:
                text = ("," if count else "[") + "\n"
                text += textwrap.indent(json.dumps(row.as_dict(), indent=1), " ")
            write(text if as_json else text + "\n")
            count += 1
            trusted += row.trusted
            found |= math.isfinite(row.pixels)
            if first is None or (first.readable and not row.readable):
                first = row
    finally:
        if count:
            plural = "s" if count != 1 else ""
            write("\n]\n" if as_json else f"{count} frame{plural}, {trusted} trusted\n")
    if first is None:
        from rigs.calibration.frames import FramesError

        raise FramesError(source, "holds no frame", "give a picture, folder, video or run")
    if found or (method != "macro" and first.readable):
        return ""
    remedy = "check that the files are pictures, and --roi"
    if method == "macro":
        remedy = "check --threshold and --roi against a --preview, or use --method edge"
    return str(PamrigError(source, first.reason, remedy))


def _draw_preview(path: Path, image: Any, **shown: Any) -> None:
    from vision.marker.preview import draw

    try:
        draw(path, image, **shown)
    except (OSError, ValueError) as error:
        raise ConfigError(
            "--preview", f"cannot write {path}: {error}", "give a name that ends in .png"
        ) from error
