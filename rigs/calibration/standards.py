"""Reading reference standards: a gauge beside the pressure sensor, gauge blocks for the lengths.

Unlike a calibration it changes nothing: it says by how much an instrument is off at places that the
diagnosis of a gap needs to know.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from analysis.regression.calibration_line import Reference
from daq.calibration import StandardReading
from daq.errors import DeviceError
from daq.interrupt import StopFlag
from daq.record.writer import RecordWriter
from rigs.bench.rig import Rig, open_rig
from rigs.calibration.pressure import pressure_steps
from rigs.calibration.run import (
    Point,
    block_mean,
    carry_out,
    open_record,
    request,
    up_and_down,
)
from rigs.devices.motion.stage import MotorStage
from rigs.devices.operator import Request, at_a_terminal, request_done, request_number
from rigs.execution.runner import Runner, Watch
from rigs.rigfile.config import CAMERA, RigConfig, camera_values
from rigs.steps.custom_step import Steps

if TYPE_CHECKING:
    from rigs.virtual.bench import VirtualBench

CAMERA_CHANNEL = "length_mm"
HOLDERS_CHANNEL = "held_length_mm"
GAUGE_CHANNEL = "pressure_kpa"
PLACES = 5
"""Blocks before the camera: enough to tell a scale from a lens that bends."""
HELD = 3
"""Distances of the holders."""
PICTURES = 10
INNER = (0.1, 0.9)
"""Part of the range of lengths that is looked at."""
PRESSURES = (0.1, 0.3, 0.5, 0.7, 0.9)
"""Where the gauge is read, as shares of the rig's limit. Not vented: the converters of many boards
end there."""
GAUGED_S = 2.0
"""How long the sensor is read beside the gauge."""
GAUGED_AT = 0.3
"""Share of the range of lengths at which the muscle is held meanwhile: short, so that it does not
pull its most."""
U_OF: Mapping[str, float] = {CAMERA_CHANNEL: 0.01, HOLDERS_CHANNEL: 0.01, GAUGE_CHANNEL: 0.3}
"""Standard uncertainty of a standard, in the unit of its channel: a length by gauge blocks with how
they are seated or wrung to feel (the advice of the diagnosis counts on 0.02 to 0.05 mm), a
reference gauge of class 0.1 to 10 bar as it is read."""


def readable_standards(config: RigConfig) -> tuple[str, ...]:
    """Channels whose standards can be read on this rig now: somebody must be there to set them."""
    if not (config.is_virtual or at_a_terminal()):
        return ()
    # A gauge is compared with the sensor of the board, where tests read that one.
    own = not config.pressure_source.sensor and config.joint is None
    found = [GAUGE_CHANNEL] if own else []
    if config.camera.source and config.length_source == CAMERA:
        found.append(CAMERA_CHANNEL)
    # Somebody who sets a length by hand reads it by the camera: no scale is written down.
    return (*found, HOLDERS_CHANNEL) if config.stage.kind != "manual" else tuple(found)


def read_standards(
    config: RigConfig,
    channels: Collection[str],
    root: Path,
    *,
    u: Mapping[str, float] = U_OF,
    who: str = "",
    stop: StopFlag | None = None,
    watch: Watch | None = None,
    bench: VirtualBench | None = None,
) -> tuple[tuple[StandardReading, ...], Path]:
    """Have a person read a gauge and set gauge blocks, and read the instruments with them.

    The gauge comes first; for the blocks the muscle is vented and taken out.

    Args:
        config: the rig.
        channels: what is to read them, of `readable_standards`.
        root: folder for the record.
        u: standard uncertainty of the standard that a channel reads, in its unit.
        who, stop, watch: as for a calibration.
        bench: the virtual bench of earlier tests, where this is to go on with it.

    Returns:
        The readings, and the folder of the record.

    Raises:
        DeviceError: the camera sees no block, or a device fails.
    """
    stop, watch = stop or StopFlag(), watch or Watch()
    low, high = config.limits.length_min_mm, config.limits.length_max_mm
    lengths = set(channels) - {GAUGE_CHANNEL}
    known = [name for name, here in _KNOWN if here & set(channels)]
    least = min(u[channel] for channel in channels)
    with open_rig(config, bench=bench) as rig:
        record = open_record(
            rig, root, "calibrate-check", Reference(" and ".join(known), u_each=least),
            {"channels": {channel: u[channel] for channel in sorted(channels)}}, who,
        )  # fmt: skip
        found: list[StandardReading] = []

        def take(channel: str, true: float, read: float, u_read: float) -> None:
            u_both = float(math.hypot(u_read, u[channel]))
            found.append(StandardReading(channel, true, read, u_both))
            record.event("standard_reading", **vars(found[-1]))

        def method() -> None:
            if GAUGE_CHANNEL in channels:
                _read_gauge(rig, record, stop, watch, take)
            if not lengths:
                return
            rig.vent()
            request(rig, "muscle off", 0.0, "mm", "take the muscle out")
            if CAMERA_CHANNEL in channels:
                for length in _places(low, high, PLACES):
                    watch.state(f"gauge block of {length:g} mm before the camera")
                    _read_block(rig, record, length, take)
            if HOLDERS_CHANNEL in channels:
                for length in _places(low, high, HELD):
                    watch.state(f"distance of the holders at {length:g} mm")
                    _read_holders(rig, length, take)
            request(rig, "muscle", 0.0, "mm", "mount the muscle again")

        carry_out(rig, record, method, stop)
    return tuple(found), record.folder


_KNOWN = (
    ("reference gauge", {GAUGE_CHANNEL}),
    ("gauge blocks", {CAMERA_CHANNEL, HOLDERS_CHANNEL}),
)
Take = Callable[[str, float, float, float], None]


def _places(low: float, high: float, count: int) -> list[float]:
    """Lengths of blocks that a set has, evenly over the inner part of a range."""
    first, last = (low + share * (high - low) for share in INNER)
    digits = 0 if last - first >= 2.0 * count else 1  # no two alike, none beyond the range
    return [float(round(length, digits)) for length in np.linspace(first, last, count)]


def _read_gauge(rig: Rig, record: RecordWriter, stop: StopFlag, watch: Watch, take: Take) -> None:
    """Pressures that the bench makes, up and down, read by a person and by the board's sensor."""
    limits = rig.config.limits
    rig.vent()  # nobody opens a line under pressure
    request(
        rig, "gauge", 0.0, "kPa",
        "connect the reference gauge beside the pressure sensor and keep your hands off: the stage "
        "may move, and the muscle is filled",
    )  # fmt: skip
    if isinstance(rig.stage, MotorStage):
        short = limits.length_min_mm + GAUGED_AT * (limits.length_max_mm - limits.length_min_mm)
        rig.stage.set_value(round(short, 1))
    calibration = rig.config.calibrations[GAUGE_CHANNEL]
    asked = Request("reference pressure", math.nan, "kPa", "read the gauge in kPa and type it")
    pressures = up_and_down([round(share * limits.pressure_kpa) for share in PRESSURES])

    def read() -> float:
        return request_number(rig.operator, rig.event_loop, asked)

    def steps() -> Steps:
        for pressure in pressures:
            points: list[Point] = []
            yield from pressure_steps(rig, record, [pressure], GAUGED_S, read, points)
            for point in points:  # none where the sensor is at its end
                shown = float(calibration.apply(point.raw))
                take(GAUGE_CHANNEL, point.reference, shown, abs(calibration.scale) * point.u_raw)

    Runner(rig, record, stop, watch, camera_values(rig.config)).run(steps(), len(pressures))
    rig.vent()
    request(rig, "gauge", 0.0, "kPa", "take the gauge off again: its volume counts as the line's")


def _read_block(rig: Rig, record: RecordWriter, length: float, take: Take) -> None:
    """One block before the camera, read as a length is in a test."""
    from rigs.steps.pictures import take_picture

    limits = rig.config.limits
    asked = Request(
        "block", length, "mm",
        f"put a gauge block of {length:g} mm, or near it, in the place of the muscle; then press "
        "Enter, or type its length in mm",
    )  # fmt: skip
    true, _ = request_done(
        rig.operator, rig.event_loop, asked, limits.length_min_mm, limits.length_max_mm
    )
    camera = camera_values(rig.config)
    pixels = []
    for _ in range(PICTURES):
        gap = take_picture(rig, record, camera).gap
        if not gap.trusted:
            raise DeviceError(
                "camera", f"sees no block of {true:g} mm: {gap.reason}",
                "its ends must show as the marks do",
            )  # fmt: skip
        pixels.append(gap.pixels)
    mean, u = block_mean(rig.config.calibrations["length_mm"].apply(pixels))
    take(CAMERA_CHANNEL, true, mean, u)


def _read_holders(rig: Rig, length: float, take: Take) -> None:
    """The distance of the holders where the stage says so, measured with blocks."""
    assert isinstance(rig.stage, MotorStage)
    request(  # a block left in, or a hand, would be caught between the holders
        rig, "clear", length, "mm",
        f"take the block out and keep your hands off: the stage goes to {length:g} mm",
    )  # fmt: skip
    written = rig.stage.set_value(length)
    asked = Request(
        "holders", math.nan, "mm",
        f"the stage stands at {written:.2f} mm: measure with gauge blocks which length a muscle "
        "would have between the holders, and type it in mm",
    )  # fmt: skip
    take(HOLDERS_CHANNEL, request_number(rig.operator, rig.event_loop, asked), written, 0.0)
