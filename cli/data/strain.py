"""`pamrig strain`: strain along a muscle and its bending, by several markers."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cli.data.pictures import Box, parse_box
from cli.options import JsonOption, bounded
from cli.progress import counting
from daq.errors import ConfigError, PamrigError

if TYPE_CHECKING:
    from rigs.rigfile.camera_calibration import CameraCalibration
    from vision.marker.several import MarkerRow


def strain(
    frames: Annotated[
        str, typer.Argument(help="Picture, folder, TIFF stack, video or run folder.")
    ],
    markers: Annotated[int, typer.Option(help="Number of dark markers along the muscle.")],
    rest: Annotated[
        str, typer.Option(help="Picture of the muscle at rest; default: the first frame.")
    ] = "",
    calibration: Annotated[Path | None, typer.Option(help="Camera calibration file.")] = None,
    roi: Annotated[str, typer.Option(help="Region left,top,width,height.")] = "",
    as_json: JsonOption = False,
) -> None:
    """Measure strain and bending by several markers; exit status 2 if no frame gave any."""
    bounded("--markers", markers, 2, 50)
    failed = strain_report(
        frames, markers, lambda part: typer.echo(part, nl=False),
        rest=rest, calibration=calibration, roi=roi, as_json=as_json,
    )  # fmt: skip
    if failed:
        typer.echo(f"pamrig: {failed}", err=True)
    raise typer.Exit(2 if failed else 0)


def strain_report(
    frames: str,
    markers: int,
    write: Callable[[str], object],
    *,
    rest: str = "",
    calibration: Path | None = None,
    roi: str = "",
    as_json: bool = False,
) -> str:
    """Write a row for each frame; returns an error text ("" if one gave a strain).

    Raises:
        PamrigError: no frames, or the markers of the rest picture cannot be measured.
    """
    from rigs.rigfile.camera_calibration import load_camera_calibration

    camera = None if calibration is None else load_camera_calibration(calibration)
    region = parse_box(roi) if roi else None
    reference: MarkerRow | None = None
    if rest:
        _, _, reference = next(_rows(rest, markers, region, camera))
        if not reference.trusted:
            raise ConfigError("--rest", f"{rest}: {reference.reason}", "take the picture again")
    out, first = [], ""
    for file, frame, row in counting(_rows(frames, markers, region, camera), "frames"):
        reference = reference or (row if row.trusted else None)
        values = _values(row, reference, camera)
        first = first or row.reason
        out.append({"file": file, "frame": frame, **values})
        if not as_json:
            write(f"{file}[{frame}] {_text(values)}\n")
    if as_json:
        write(json.dumps(out, indent=1) + "\n")
    if any(row["trusted"] for row in out):
        return ""
    return str(PamrigError(frames, first or "holds no frame", "check --markers and --roi"))


def _rows(
    source: str, markers: int, region: Box | None, camera: CameraCalibration | None
) -> Iterator[tuple[str, int, MarkerRow]]:
    from rigs.calibration.frames import open_frames
    from vision.gray import FrameError, RegionError
    from vision.marker.several import MarkerRow, measure_markers

    lens = None if camera is None else camera.lens
    for item in open_frames(source):
        row = MarkerRow(reason=item.problem)
        if item.image is not None:
            try:
                row = measure_markers(item.image, markers, region, lens)
            except (FrameError, RegionError) as error:
                row = MarkerRow(reason=str(error))
        yield item.file, item.frame, row


def _values(
    row: MarkerRow, rest: MarkerRow | None, camera: CameraCalibration | None
) -> dict[str, Any]:
    """Strain in percent, chord and curvature; in mm where the camera is calibrated."""
    from vision.marker.several import strain as strain_of

    if not row.trusted or rest is None:
        return {"trusted": False, "reason": row.reason}
    found = strain_of(row, rest)
    scale = None if camera is None else camera.calibration
    out = {
        "strain_percent": [100.0 * v for v in found.segments],
        "u_strain_percent": [100.0 * v for v in found.u_segments],
        "mean_strain_percent": 100.0 * found.mean,
        "u_mean_strain_percent": 100.0 * found.u_mean,
        "bend_deg": math.degrees(row.turn),
        "u_bend_deg": math.degrees(row.u_turn),
        "chord_pixels": row.chord_px,
        "u_chord_pixels": row.u_chord_px,
    }
    if scale is not None:  # a distance: the offset of a length does not count
        mm = abs(scale.scale)
        curvature = row.curvature / mm
        out |= {
            "chord_mm": row.chord_px * mm,
            "u_chord_mm": math.hypot(row.u_chord_px * mm, scale.u_gain * row.chord_px * mm),
            "curvature_per_m": 1e3 * curvature,
            "u_curvature_per_m": 1e3 * math.hypot(row.u_curvature / mm, scale.u_gain * curvature),
        }
    return {**out, "trusted": True, "reason": ""}


def _text(values: dict[str, Any]) -> str:
    if not values["trusted"]:
        return f"no strain: {values['reason']}"
    pairs = zip(values["strain_percent"], values["u_strain_percent"], strict=True)
    text = (
        f"strain {values['mean_strain_percent']:.3f} % (u {values['u_mean_strain_percent']:.3f}); "
        f"segments {', '.join(f'{v:.3f} (u {u:.3f})' for v, u in pairs)}; "
        f"bend {values['bend_deg']:.3f} deg (u {values['u_bend_deg']:.3f}); "
    )
    if "chord_mm" not in values:
        return text + f"chord {values['chord_pixels']:.3f} pixels"
    return text + (
        f"chord {values['chord_mm']:.3f} mm (u {values['u_chord_mm']:.3f}), curvature "
        f"{values['curvature_per_m']:.3f} 1/m (u {values['u_curvature_per_m']:.3f})"
    )
