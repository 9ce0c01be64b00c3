"""`pamrig pose`: position and angle of ArUco and ChArUco markers in pictures."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cli.data.pictures import recorded_run
from cli.options import RUNS, JsonOption, RunsOption
from cli.progress import counting
from daq.errors import ConfigError, PamrigError

if TYPE_CHECKING:
    from vision.pose.measure import MarkPose, MarkSettings

QUANTITIES = ("x_mm", "y_mm", "angle_deg")


def pose(
    frames: Annotated[
        str, typer.Argument(help="Picture, folder, TIFF stack, video, run folder or run id.")
    ],
    marks: Annotated[
        Path | None, typer.Option(help="File of the markers; a run has its own.")
    ] = None,
    still: Annotated[
        bool, typer.Option("--still", help="The markers do not move: state mean and scatter.")
    ] = False,
    preview: Annotated[
        Path | None, typer.Option(help="Write a picture of the first measurement.")
    ] = None,
    runs: RunsOption = RUNS,
    as_json: JsonOption = False,
) -> None:
    """Measure position and angle of markers; exit status 2 if no frame gave a pose."""
    failed = pose_report(
        frames, marks, lambda part: typer.echo(part, nl=False),
        still=still, preview=preview, runs=runs, as_json=as_json,
    )  # fmt: skip
    if failed:
        typer.echo(f"pamrig: {failed}", err=True)
    raise typer.Exit(2 if failed else 0)


def pose_report(
    frames: str,
    marks: Path | None,
    write: Callable[[str], object],
    *,
    still: bool = False,
    preview: Path | None = None,
    runs: Path = RUNS,
    as_json: bool = False,
) -> str:
    """Write a row for each mark of each frame; returns an error text ("" if one gave a pose).

    Raises:
        PamrigError: no frames, or no settings of marks.
    """
    folder, settings = settings_of(frames, marks, runs)
    rows: list[tuple[str, int, MarkPose]] = []
    for file, frame, found, image in counting(_measured(folder, settings), "frames"):
        if preview is not None and image is not None:
            _draw(preview, image, found)
            preview = None
        for row in found.poses.values():
            rows.append((file, frame, row))
            if not as_json:
                write(f"{file}[{frame}] {_as_text(row)}\n")
    summary = summarise([row for _, _, row in rows]) if still else {}
    if as_json:
        out: Any = [{"file": f, "frame": n, **row.as_dict()} for f, n, row in rows]
        write(json.dumps({"frames": out, "still": summary} if still else out, indent=1) + "\n")
    else:
        for name, found in summary.items():
            write(_summary_text(name, found))
    if any(row.trusted for _, _, row in rows):
        return ""
    reason = rows[0][2].reason if rows else "holds no frame"
    return str(PamrigError(frames, reason, "check the file of the marks, focus and light"))


def settings_of(frames: str, marks: Path | None, runs: Path) -> tuple[str | Path, MarkSettings]:
    """Where the frames are, and which marks to measure.

    Raises:
        ConfigError: neither a file nor the run states marks.
    """
    from analysis.reduction.pictures import camera_of
    from rigs.rigfile.tables.marks import load_marks
    from vision.pose.measure import MarkSettings

    run = recorded_run(frames, runs)
    folder: str | Path = frames if run is None else run.folder
    if marks is not None:
        return folder, load_marks(marks)
    stated = camera_of(run).get("marks") if run is not None else None
    if stated is None:
        raise ConfigError("--marks", "which marks are to be measured?", "give a file of marks")
    return folder, MarkSettings.from_dict(stated)


def _measured(source: str | Path, settings: MarkSettings) -> Iterator[tuple[str, int, Any, Any]]:
    import numpy as np

    from rigs.calibration.frames import open_frames
    from vision.gray import FrameError, to_gray
    from vision.pose.measure import MarkPose, PoseMeasurement, measure_pose

    for item in open_frames(source):
        problem, gray = item.problem, None
        if item.image is not None:
            try:
                gray = np.rint(to_gray(item.image)).astype(np.uint8)
            except FrameError as error:
                problem = str(error)
        if gray is None:
            lost = {name: MarkPose(name, reason=problem) for name in settings.measured}
            yield item.file, item.frame, PoseMeasurement(lost, {}), None
        else:
            yield item.file, item.frame, measure_pose(gray, settings), gray


def summarise(rows: list[MarkPose]) -> dict[str, dict[str, float]]:
    """Of each mark: frames, means, scatter of one frame, and the uncertainty of the mean."""
    from analysis.reduction.poses import still_mean

    out: dict[str, dict[str, float]] = {}
    for name in dict.fromkeys(row.name for row in rows):
        good = [row for row in rows if row.name == name and row.trusted]
        found: dict[str, float] = {"frames": len(good), "refused": 0}
        found["refused"] = sum(row.name == name for row in rows) - len(good)
        for quantity in QUANTITIES if good else ():
            values = [getattr(row, quantity) for row in good]
            us = [getattr(row, f"u_{quantity}") for row in good]
            turns = quantity == "angle_deg"
            found[quantity], found[f"u_{quantity}"] = still_mean(values, us, turns)
            off = [value - found[quantity] for value in values]
            if turns:
                off = [math.remainder(value, 360.0) for value in off]
            found[f"sd_{quantity}"] = math.sqrt(sum(v * v for v in off) / max(1, len(off) - 1))
        out[name] = found
    return out


def _as_text(row: MarkPose) -> str:
    if not row.trusted:
        return f"{row.name}: no pose: {row.reason}"
    return (
        f"{row.name}: x {row.x_mm:.3f} mm (u {row.u_x_mm:.3f}), y {row.y_mm:.3f} mm "
        f"(u {row.u_y_mm:.3f}), angle {row.angle_deg:.3f} deg (u {row.u_angle_deg:.3f})"
    )


def _summary_text(name: str, found: dict[str, float]) -> str:
    head = f"{name}: {found['frames']:g} frames, {found['refused']:g} refused"
    if not found["frames"]:
        return head + "\n"
    parts = [
        f"{quantity} {found[quantity]:.4f}, sd {found[f'sd_{quantity}']:.4f}, "
        f"u {found[f'u_{quantity}']:.4f}"
        for quantity in QUANTITIES
    ]
    return f"{head}; {'; '.join(parts)}\n"


def _draw(path: Path, gray: Any, found: Any) -> None:
    """A picture with the corners that were used and the names of the marks."""
    import cv2
    import numpy as np

    shown = cv2.cvtColor(gray, cv2.COLOR_GRAY2BGR)
    for name, corners in found.corners.items():
        for corner in np.rint(corners).astype(int):
            cv2.drawMarker(shown, tuple(int(v) for v in corner), (0, 0, 255), cv2.MARKER_CROSS, 9)
        row = found.poses.get(name)
        text = name if row is None or not row.trusted else f"{name} {row.angle_deg:.2f} deg"
        place = np.rint(corners.max(axis=0) + 4.0).astype(int)
        cv2.putText(
            shown, text, tuple(int(v) for v in place), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (200, 80, 0)
        )
    try:
        written = cv2.imwrite(str(path), shown)
    except cv2.error:
        written = False
    if not written:
        raise ConfigError(
            "--preview",
            f"cannot write {path}",
            "give a name that ends in .png in a folder there is",
        )
