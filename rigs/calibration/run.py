"""What calibrations of a sensor share: points, their record, and the line through them."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from analysis.regression.calibration_line import LEAST_POINTS, Reference, fit_line
from daq.calibration import Calibration
from daq.clock import NS_PER_S
from daq.errors import ConfigError, PamrigError
from daq.interrupt import StopFlag
from daq.record.writer import RecordWriter
from rigs.bench.rig import Rig
from rigs.devices.operator import Request, request_enter
from rigs.execution.manifest import software
from rigs.execution.runner import Watch, outcome_of
from rigs.rigfile.calibration_file import CalibrationFile

BLOCKS = 10


@dataclass(frozen=True)
class Point:
    """One point of a calibration: mean reading, its standard uncertainty, the reference."""

    raw: float
    u_raw: float
    reference: float


@dataclass(frozen=True)
class Calibrated:
    """The result, its points (reading, reference, residual) and the record's folder."""

    file: CalibrationFile
    points: tuple[tuple[float, float, float], ...]
    folder: Path


def up_and_down(values: Sequence[float]) -> list[float]:
    """Rising, then falling, the highest once: what a reference meets it meets from both sides."""
    rising = sorted(set(values))
    return rising + rising[-2::-1]


def block_mean(values: npt.ArrayLike, resolution: float = 0.0) -> tuple[float, float]:
    """(mean, its standard uncertainty) of readings that follow each other closely.

    From the scatter of block means, because neighbours are not independent; never below what
    the resolution leaves open.
    """
    v = np.asarray(values, dtype=np.float64)
    blocks = [b.mean() for b in np.array_split(v, min(BLOCKS, len(v))) if len(b)]
    spread = float(np.std(blocks, ddof=1) / np.sqrt(len(blocks))) if len(blocks) > 1 else 0.0
    return float(v.mean()), float(np.hypot(spread, resolution / np.sqrt(12 * len(v))))


def middle(counts: npt.ArrayLike) -> float:
    """Median of whole counts, interpolated within its count."""
    v = np.asarray(counts, dtype=np.float64)
    median = float(np.floor(np.median(v)))
    below, at = float(np.mean(v < median)), float(np.mean(v == median))
    return median - 0.5 + (0.5 - below) / at if at else median


def open_record(
    rig: Rig, root: Path, protocol: str, known: Reference, parameters: dict[str, Any], who: str
) -> RecordWriter:
    """The record of a calibration: rig, reference, devices, what was in force before."""
    config = rig.config
    manifest = {
        "protocol": protocol,
        "parameters": {**parameters, "reference": dict(vars(known))},
        "specimen": "sensor",
        "operator": who,
        "rig": {"name": config.name, "description": config.description, "source": config.source,
                "crc32": config.crc32, "text": config.text},
        "calibrations": {k: c.to_dict() for k, c in config.calibrations.items()},
        "devices": rig.identities,
        "software": software(),
    }  # fmt: skip
    virtual = rig.clock.virtual
    return RecordWriter(root, manifest, rig.clock, durable=not virtual, threaded=not virtual)


def carry_out(rig: Rig, record: RecordWriter, method: Callable[[], None], stop: StopFlag) -> None:
    """Run the method and close the record however it ends.

    A stop request is seen in every wait of the method, also while a person is asked.
    """
    error: BaseException | None = None
    rig.event_loop.add(stop.check)
    try:
        method()
    except BaseException as caught:
        error = caught
        raise
    finally:
        rig.event_loop.remove(stop.check)  # what makes the bench safe is not interrupted
        with contextlib.suppress(PamrigError):
            record.finalize(
                outcome_of(error),
                reason=str(error) if error is not None else "",
                duration_s=(rig.clock.now_ns() - record.start_ns) / NS_PER_S,
            )


def check_values(
    option: str, values: Sequence[float], low: float, high: float, unit: str, limit: str
) -> None:
    """See that the values of the reference are enough, and within a limit of the rig.

    Args:
        option: which of the command line gave them.
        values: of the reference, in ``unit``.
        low, high: between which they must lie.
        limit: file and key of these.

    Raises:
        ConfigError: they are not.
    """
    if len(set(values)) < LEAST_POINTS:
        raise ConfigError(
            option, f"at least {LEAST_POINTS} different values are needed", "add some"
        )
    for value in values:
        if not low <= value <= high:
            raise ConfigError(
                option, f"{value:g} {unit} is outside {low:.4g} to {high:.4g} {unit} ({limit})",
                "correct the list or the limit",
            )  # fmt: skip


def request(rig: Rig, axis: str, value: float, unit: str, text: str) -> None:
    """Have a person set something, confirmed by Enter."""
    put = Request(axis, value, unit, f"{text}, then press Enter")
    request_enter(rig.operator, rig.event_loop, put)


def over_range(counters: Mapping[str, int]) -> int:
    """How many readings of a sensor were at an end of what it can read, by its counters.

    They are no rows; the mean of those beside them leans away from that end.
    """
    return sum(counters.get(kind, 0) for kind in ("overload", "underload", "range"))


def leave_out(record: RecordWriter, watch: Watch, where: str, device: str, **point: Any) -> None:
    """Record and show that a point was not taken, as the sensor was at the end of its range."""
    record.event("left_out", device=device, **point)
    watch.log(f"{where}: left out, {device} is at the end of its range")


def add_point(record: RecordWriter, points: list[Point], point: Point) -> None:
    """Keep a point, also in the record."""
    points.append(point)
    record.event("calibration_point", **vars(point))


def finish(
    record: RecordWriter,
    rig: Rig,
    old: Calibration,
    serial: str,
    points: list[Point],
    known: Reference,
    zeros: Sequence[float] = (),
) -> Calibrated:
    """Fit and file. ``zeros`` is what repeated tares left: a test begins with a tare, so its
    offset is their mean, and what they scatter belongs to its uncertainty.
    """
    reference = np.array([p.reference for p in points])
    fit = fit_line(
        [p.raw for p in points], [p.u_raw for p in points], reference, known,
        f"calibration {old.quantity}",
    )  # fmt: skip
    offset, u_offset = fit.offset, fit.u_offset
    if zeros:
        left = np.asarray(zeros) * fit.scale
        offset = -float(left.mean())
        scatter = float(left.std(ddof=1)) * np.sqrt(1 + 1 / len(left))
        u_offset = float(np.hypot(u_offset, scatter))
    date = datetime.fromtimestamp(rig.clock.wall_ns() / NS_PER_S, tz=UTC).date().isoformat()
    letter = old.quantity[0].upper()
    calibration = Calibration(
        quantity=old.quantity,
        unit=old.unit,
        raw_unit=old.raw_unit,
        offset=offset,
        scale=fit.scale,
        u_offset=u_offset,
        u_gain=fit.u_gain,
        domain=(float(reference.min()), float(reference.max())),
        id=f"{letter}-{serial or rig.config.name}-{date}",
        date=date,
        note=f"record {record.run_id}; {len(points)} points, up and down",
    )
    file = CalibrationFile(calibration, serial, fit.linearity, known.name)
    rows = tuple((p.raw, p.reference, float(r)) for p, r in zip(points, fit.residuals, strict=True))
    return Calibrated(file, rows, record.folder)
