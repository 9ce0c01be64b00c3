"""`pamrig calibrate camera`: pixels to millimetres, from gauge blocks or from a board.

Gauge blocks: a table says which picture shows which length; length = offset + scale * gap is
fitted, and with five or more positions the lens distortion too. Board: a chessboard in the
plane of the marks gives scale and distortion, and with a second picture at a known distance
from that plane how the scale changes off the plane.
"""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from daq.calibration import Calibration
from daq.errors import ConfigError
from plant import tomlfile
from plant.arrays import Array
from rigs.calibration.frames import open_frames
from rigs.rigfile.camera_calibration import CameraCalibration
from vision.marker.gap import GapMeasurement
from vision.marker.lens import Lens


@dataclass(frozen=True)
class GaugePosition:
    """One row of the gauge-block table."""

    file: str
    length_mm: float
    u_mm: float


def read_gauge_table(path: Path) -> list[GaugePosition]:
    """Rows of a CSV (file, length_mm, u_mm) or a TOML ([[position]] with the same keys).

    Raises:
        ConfigError: names file and row of what cannot be read.
    """
    try:
        if path.suffix.lower() == ".toml":
            rows = tomlfile.loads(tomlfile.read_text(path)).get("position", [])
        else:
            with open(path, newline="", encoding="utf-8-sig") as file:
                rows = list(csv.DictReader(file))
    except (OSError, ValueError) as error:
        raise ConfigError(str(path), f"not a table: {error}", "give a CSV or a TOML") from error
    out: list[GaugePosition] = []
    for k, row in enumerate(rows):
        try:
            length_mm, u_mm = float(row["length_mm"]), float(row.get("u_mm") or 0.0)
            if not (0.0 < length_mm < math.inf and 0.0 <= u_mm < math.inf):
                raise ValueError("a length above 0 and an uncertainty from 0 up are expected")
            out.append(GaugePosition(str(row["file"]), length_mm, u_mm))
        except (KeyError, TypeError, ValueError) as error:
            raise ConfigError(
                f"{path}, row {k + 1}",
                f"expected file, length_mm and u_mm, got {dict(row)}: {error}",
                "columns: file,length_mm,u_mm",
            ) from error
    if len(out) < 2:
        raise ConfigError(str(path), f"{len(out)} positions", "give at least 2, better 5 or more")
    return out


def calibrate_from_gauges(
    table: Path,
    *,
    identity: str = "",
    date: str = "",
    distance_mm: float | None = None,
    u_off_plane_mm: float = 0.0,
) -> CameraCalibration:
    """Fit offset, scale and, with 5 or more positions, distortion to gauge-block pictures.

    Args:
        table: see ``read_gauge_table``; pictures stand beside it.
        distance_mm: from the lens to the plane of the marks: the scale then changes by
            1/distance for each mm off the plane.

    Raises:
        ConfigError: a picture gives no trusted gap, or all lengths are alike.
    """
    positions = read_gauge_table(table)
    gaps: list[GapMeasurement] = []
    shape = (0, 0)
    from vision.marker.edge import measure_gap

    for position in positions:
        item = next(iter(open_frames(table.parent / position.file)))
        if item.image is None:
            raise ConfigError(f"{table}, {position.file}", item.problem, "take it again")
        shape = item.image.shape[:2]
        gap = measure_gap(item.image)
        if not gap.trusted:
            raise ConfigError(
                f"{table}, {position.file}", f"no trusted gap: {gap.reason}", "take it again"
            )
        gaps.append(gap)
    lengths = np.array([p.length_mm for p in positions])
    u_mm = np.array([p.u_mm for p in positions])
    if np.ptp(lengths) <= 0:
        raise ConfigError(str(table), "all lengths are alike", "give two or more lengths")
    lens: Lens | None = None
    radius = 0.5 * math.hypot(*shape)
    if len(positions) >= 5:
        lens = _fit_lens(gaps, lengths, Lens(shape[1] / 2, shape[0] / 2, radius))
    pixels = np.array([lens.gap(g)[0] if lens else g.pixels for g in gaps])
    u_px = np.array([g.u_pixels for g in gaps])
    design = np.stack([np.ones_like(pixels), pixels], axis=1)
    fit, *_ = np.linalg.lstsq(design, lengths, rcond=None)
    scale = float(fit[1])
    rest = lengths - design @ fit
    freedom = len(lengths) - 2 - (lens is not None)
    expected2 = float(np.mean((scale * u_px) ** 2 + u_mm**2))
    s2 = max(expected2, float(rest @ rest) / freedom if freedom > 0 else 0.0)
    cov = s2 * np.linalg.inv(design.T @ design)
    if lens is not None:  # a wrong k1 bends every length in common
        cov[1, 1] += (scale * lens.u_k1) ** 2
    # offset and slope errors are tied together: state them so that hypot(u_offset,
    # u_gain * (value - offset)) covers the fit over the domain
    middle = float(pixels.mean())
    at_middle = cov[0, 0] + 2 * middle * cov[0, 1] + middle**2 * cov[1, 1]
    ends = np.array([pixels.min(), pixels.max()])
    at_ends = cov[0, 0] + 2 * ends * cov[0, 1] + ends**2 * cov[1, 1]
    u_offset = math.sqrt(float(max(at_middle, at_ends.max())))
    u_gain = math.sqrt(float(cov[1, 1])) / abs(scale)
    per_mm = 1.0 / distance_mm if distance_mm else 0.0
    straight = Calibration(
        quantity="length_mm",
        unit="mm",
        raw_unit="pixel",
        offset=float(fit[0]),
        scale=scale,
        u_offset=u_offset,
        u_gain=u_gain,
        domain=(float(lengths.min()), float(lengths.max())),
        id=identity or f"gauge blocks, {table.name}",
        date=date or datetime.now(UTC).date().isoformat(),
        note=f"{len(lengths)} positions, rms residual {math.sqrt(float(np.mean(rest**2))):.5f} mm",
    )
    return CameraCalibration(straight, lens, per_mm, 0.0, u_off_plane_mm)


def _fit_lens(gaps: list[GapMeasurement], lengths: Array, start: Lens) -> Lens | None:
    """Distortion k1 that makes the lengths straight; None where it is not significant."""
    from scipy.optimize import least_squares

    u = np.array([max(g.u_pixels, 1e-4) for g in gaps])

    def rest(k1: Array) -> Array:
        lens = replace(start, k1=float(k1[0]))
        pixels = np.array([lens.gap(g)[0] for g in gaps])
        design = np.stack([np.ones_like(pixels), pixels], axis=1)
        fit, *_ = np.linalg.lstsq(design / u[:, None], lengths / u, rcond=None)
        value: Array = (lengths - design @ fit) / (u * abs(fit[1]))
        return value

    found = least_squares(rest, np.zeros(1), diff_step=1e-4, x_scale=1e-3)
    freedom = max(1, len(gaps) - 3)
    s2 = max(1.0, 2.0 * float(found.cost) / freedom)
    u_k1 = math.sqrt(s2 / max(1e-12, float((found.jac.T @ found.jac)[0, 0])))
    k1 = float(found.x[0])
    if abs(k1) < 2.0 * u_k1:
        return None
    return replace(start, k1=k1, u_k1=u_k1)


def calibrate_from_board(  # noqa: PLR0913 - what a calibration states, each by name
    picture: Path,
    squares: tuple[int, int],
    square_mm: float,
    *,
    offset_mm: float = 0.0,
    u_offset_mm: float = 0.0,
    domain: tuple[float, float] = (-math.inf, math.inf),
    nearer: Path | None = None,
    nearer_mm: float = 0.0,
    u_off_plane_mm: float = 0.0,
    identity: str = "",
    date: str = "",
) -> CameraCalibration:
    """Scale and distortion from a chessboard held in the plane of the marks.

    Args:
        squares: inner corners across and down. square_mm: side of a square.
        offset_mm: length at zero gap, which a board cannot tell.
        nearer, nearer_mm: the board again, that much nearer to the camera.

    Raises:
        ConfigError: the board is not found, or its squares have no size.
    """
    if not 0.0 < square_mm < math.inf:
        raise ConfigError("--square-mm", f"{square_mm:g} mm is not a valid side length")
    scale, u_scale, lens, rms, corners = _board(picture, squares, square_mm)
    per_mm = u_per_mm = 0.0
    if nearer is not None and nearer_mm:
        other, u_other, *_ = _board(nearer, squares, square_mm)
        per_mm = (scale / other - 1.0) / nearer_mm
        u_per_mm = math.hypot(u_scale, u_other) / scale / abs(nearer_mm)
    straight = Calibration(
        quantity="length_mm",
        unit="mm",
        raw_unit="pixel",
        offset=offset_mm,
        scale=scale,
        u_offset=u_offset_mm,
        u_gain=abs(u_scale / scale),
        domain=domain,
        id=identity or f"board, {picture.name}",
        date=date or datetime.now(UTC).date().isoformat(),
        note=f"{corners} corners, rms residual {rms:.4f} pixels",
    )
    return CameraCalibration(straight, lens, per_mm, u_per_mm, u_off_plane_mm)


def _board(
    picture: Path, squares: tuple[int, int], square_mm: float
) -> tuple[float, float, Lens | None, float, int]:
    """Scale (mm a pixel) and its u, lens, rms residual in pixels, corners."""
    import cv2
    from scipy.optimize import least_squares

    item = next(iter(open_frames(picture)))
    assert item.image is not None
    gray = item.image if item.image.dtype == np.uint8 else (item.image / 257).astype(np.uint8)
    found, corners = cv2.findChessboardCornersSB(gray, squares, flags=cv2.CALIB_CB_ACCURACY)
    if not found:
        raise ConfigError(
            str(picture),
            f"no chessboard of {squares[0]} x {squares[1]} inner corners found",
            "check the count of inner corners, focus and light",
        )
    seen = np.asarray(corners, dtype=np.float64).reshape(-1, 2) + 0.5
    across, down = squares
    board = np.stack(np.meshgrid(np.arange(across), np.arange(down)), axis=-1).reshape(-1, 2)
    board = (board - board.mean(axis=0)) * square_mm
    height, width = gray.shape
    start = Lens(width / 2, height / 2, 0.5 * math.hypot(width, height))
    centred = seen - seen.mean(axis=0)
    turn = np.linalg.lstsq(board, centred, rcond=None)[0]  # mm to pixels
    first = np.array(
        [*seen.mean(axis=0), turn[0, 0], turn[0, 1], turn[1, 0], turn[1, 1], 0, 0, 0.0]
    )

    def rest(p: Array) -> Array:
        lens = replace(start, k1=float(p[8]))
        true = np.array([lens.true(x, y) for x, y in seen])
        plane = board @ p[2:6].reshape(2, 2) / (1 + board @ p[6:8])[:, None] + p[:2]
        value: Array = (true - plane).ravel()
        return value

    fit = least_squares(rest, first, x_scale=np.maximum(np.abs(first), 1e-4))
    s2 = 2.0 * float(fit.cost) / max(1, 2 * len(seen) - 9)
    cov = s2 * np.linalg.pinv(fit.jac.T @ fit.jac)
    row = fit.x[2:4]  # along the board's first axis: the direction of the gap when it lies so
    pixels_a_mm = float(np.hypot(*row))
    u = math.sqrt(float(row @ cov[2:4, 2:4] @ row)) / pixels_a_mm
    k1, u_k1 = float(fit.x[8]), math.sqrt(float(cov[8, 8]))
    lens = replace(start, k1=k1, u_k1=u_k1) if abs(k1) > 2 * u_k1 else None
    scale = 1.0 / pixels_a_mm
    return scale, u * scale**2, lens, math.sqrt(s2), len(seen)
