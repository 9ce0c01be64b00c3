"""Calibrating an instrument of length with gauge blocks or with the stage.

Gauge blocks are put in the place of the muscle, one after the other, up and down. A motor stage
that was compared with blocks before takes their place where `by_stage` says so: its position is the
length then.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from analysis.regression.calibration_line import LEAST_POINTS, Reference
from daq.errors import ConfigError, PamrigError
from daq.interrupt import StopFlag
from plant.arrays import Array
from rigs.bench.rig import Rig, open_rig
from rigs.calibration.run import (
    Calibrated,
    Point,
    add_point,
    block_mean,
    carry_out,
    check_values,
    finish,
    leave_out,
    open_record,
    over_range,
    request,
    up_and_down,
)
from rigs.devices.interfaces import Instrument
from rigs.devices.motion.stage import MotorStage
from rigs.execution.runner import Watch
from rigs.rigfile.config import CAMERA, RigConfig

REST_S = 1.0
"""So long a block, or the stage, is left alone before it is measured."""
LEAST_READINGS = 4
TRAVEL = 1e-3
"""Readings that change by less of what the instrument itself states of the lengths do not follow
them: it does not look at the block."""


def calibrate_length(  # noqa: PLR0913 - reference, instrument and hooks, each by name
    config: RigConfig,
    lengths_mm: Sequence[float],
    root: Path,
    *,
    blocks: Reference,
    instrument: str = "",
    by_stage: bool = False,
    seconds: float = 2.0,
    who: str = "",
    stop: StopFlag | None = None,
    watch: Watch | None = None,
) -> Calibrated:
    """Calibrate an instrument that reads a length.

    Args:
        config: the rig.
        lengths_mm: of the blocks, or to which the stage goes; each up and down.
        root: folder for the record.
        blocks: the reference; ``u_each`` of one length, ``u_offset`` common to all (how a block is
            seated, the zero of the stage), in mm; ``u_gain`` relative.
        instrument: its name; the length_source of the rig by default.
        by_stage: the stage instead of blocks.
        seconds: how long each length is measured, after it has come to rest.
        who, stop, watch: as for the pressure.

    Raises:
        ConfigError: no such instrument, no stage, too few lengths, or one beyond the limits.
        PamrigError: the instrument gave too few readings, or readings that do not change.
    """
    name = _instrument(config, instrument)
    check_values(
        "--lengths-mm", lengths_mm, config.limits.length_min_mm, config.limits.length_max_mm, "mm",
        f"{config.source}: limits.length_min_mm and length_max_mm",
    )  # fmt: skip
    stop, watch = stop or StopFlag(), watch or Watch()
    parameters = {
        "lengths_mm": list(lengths_mm), "seconds": seconds, "instrument": name,
        "by": "stage" if by_stage else "blocks",
    }  # fmt: skip
    with open_rig(config) as rig:
        stage = rig.stage
        if by_stage and not isinstance(stage, MotorStage):
            raise ConfigError(
                f"{config.source}: stage", "is set by hand and reports no position",
                "use gauge blocks: leave out --by-stage",
            )  # fmt: skip
        reader = rig.instruments[name]
        record = open_record(rig, root, "calibrate-length", blocks, parameters, who)
        seen: list[tuple[float, Array]] = []
        points: list[Point] = []

        def method() -> None:
            if not by_stage:
                request(rig, "muscle off", 0.0, "mm", "take the muscle out")
            for length in up_and_down(lengths_mm):
                watch.state(f"calibrate length: {length:g} mm")
                at_mm = length
                if by_stage:
                    at_mm = stage.set_value(length)
                else:
                    request(rig, "block", length, "mm", f"put a gauge block of {length:g} mm in")
                rig.event_loop.for_seconds(REST_S)
                readings = _read(rig, reader, seconds)
                if readings is None:
                    where = f"calibrate length, {length:g} mm"
                    leave_out(record, watch, where, reader.name, reference=at_mm)
                    continue
                seen.append((at_mm, readings))
                record.event("calibration_readings", reference=at_mm, readings=list(readings))
            for point in _points(reader, seen):
                add_point(record, points, point)
            if not by_stage:
                request(rig, "muscle", 0.0, "mm", "mount the muscle again")

        carry_out(rig, record, method, stop)
        old = reader.calibration
        assert old is not None
        serial = config.instruments.readers()[name].serial
        return finish(record, rig, old, serial, points, blocks)


def _instrument(config: RigConfig, instrument: str) -> str:
    """The instrument to calibrate, which must read a length."""
    readers = config.instruments.readers()
    fit = [name for name, device in readers.items() if device.form.quantity == "length_mm"]
    if not instrument and config.length_source == CAMERA and len(fit) != 1:
        raise ConfigError(
            config.source, "its length is measured by the camera",
            "`pamrig calibrate camera` calibrates that; or name an instrument with --instrument",
        )  # fmt: skip
    name = instrument or (config.length_source if config.length_source != CAMERA else fit[0])
    if name not in fit:
        what = "reads no length" if name in readers else "is no instrument of this rig"
        raise ConfigError(
            "instrument", f"{name!r} {what} ({config.source})", f"one of: {', '.join(fit) or '-'}"
        )
    return name


def _read(rig: Rig, reader: Instrument, seconds: float) -> Array | None:
    """The readings of so many seconds, as they came; None if some were at the end of the range.

    Raises:
        PamrigError: too few came.
    """
    n = max(LEAST_READINGS, round(seconds * reader.rate_hz))
    start, over = reader.rows, over_range(reader.counters())
    whole = rig.event_loop.until(
        lambda: reader.rows >= start + n or over_range(reader.counters()) > over,
        3.0 * n / reader.rate_hz + 2.0,
    )
    if over_range(reader.counters()) > over:
        return None
    if not whole:
        raise PamrigError(
            reader.name, f"sent {reader.rows - start} of {n} readings",
            reader.last_problem or "check its cable, and whether the length is in its range",
        )  # fmt: skip
    return reader.recent(n)[0].copy()


def _points(reader: Instrument, seen: Sequence[tuple[float, Array]]) -> list[Point]:
    """Means with what noise and the step of the readings leave open.

    Raises:
        PamrigError: too few lengths, or the readings do not follow them.
    """
    if len(seen) < LEAST_POINTS:
        raise PamrigError(
            reader.name, f"points within its range: {len(seen)}, needed: {LEAST_POINTS}",
            "choose lengths in its range, or place it elsewhere",
        )  # fmt: skip
    distinct = np.unique(np.concatenate([readings for _, readings in seen]))
    step = float(np.diff(distinct).min()) if len(distinct) > 1 else 0.0
    lengths = np.array([length for length, _ in seen])
    read_mm = reader.apply([float(readings.mean()) for _, readings in seen])
    if np.ptp(read_mm) < TRAVEL * np.ptp(lengths):
        raise PamrigError(
            reader.name, f"its readings change by {np.ptp(read_mm):.3g} mm over lengths that change"
            f" by {np.ptp(lengths):.3g} mm", "check what it looks at, and its holder",
        )  # fmt: skip
    out = []
    for length, readings in seen:
        mean, u = block_mean(readings, step)
        if np.ptp(readings) == 0.0:  # no noise moves the readings across a step
            u = step / np.sqrt(12.0)
        out.append(Point(mean, float(u), length))
    return out
