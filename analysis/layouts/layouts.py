"""The live layout of isometric tests, the panels that other tests share, and picture overlays."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from daq.live.layout import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SKY,
    VERMILLION,
    YELLOW,
    Axis,
    Channel,
    EventFeed,
    Feed,
    LiveLayout,
    Panel,
    PointFeed,
)

if TYPE_CHECKING:
    from daq.live.scene import Line
    from daq.store.run import Run
    from vision.marker.gap import GapMeasurement

Box = tuple[int, int, int, int]
PROFILE_POINTS = 120

SET_POINT = "pressure/set_point_kpa"
PRESSURE = "pressure/measured_kpa"
FORCE = "force/measured_n"
LENGTH = "length/measured_mm"
SET_LENGTH = "length/set_mm"
INLET = "valves/inlet_percent"
OUTLET = "valves/outlet_percent"
STATE = "state/protocol"
FAULT = "state/fault"
CAMERA = "camera"
LOG = "log"
POINTS = "points/force_n"

# Colours of the states that all protocols have; the viewer chooses colours of others.
STATE_COLOURS = (
    ("precondition", PURPLE),
    ("zero", GREY),
    ("move", YELLOW),
    ("settle", ORANGE),
    ("point", GREEN),
    ("measure", GREEN),
    ("vent", SKY),
    ("done", BLUE),
    ("none", (60, 64, 68)),
    ("fault", VERMILLION),
)


PRESSURE_FEEDS = (Feed(SET_POINT, "valve", "target_kpa"), Feed(PRESSURE, "valve", "pressure_kpa"))
VALVE_FEEDS = (
    Feed(INLET, "valve", "inlet_cmd", scale=100.0),
    Feed(OUTLET, "valve", "outlet_cmd", scale=100.0),
)
STATE_FEEDS = (EventFeed(STATE, "state", "state"), EventFeed(FAULT, "fault", "text"))
VALVES = Panel(
    "Valves, share of time commanded open (%)",
    "series",
    "valves",
    (
        Channel(INLET, "inlet, commanded open", "%", SKY, reduce="mean", readout=False),
        Channel(OUTLET, "outlet, commanded open", "%", VERMILLION, reduce="mean", readout=False),
    ),
    y_range=(-5.0, 105.0),
)
STATES = Panel(
    "Steps of the test, and faults",
    "states",
    "state",
    (Channel(STATE, "step"), Channel(FAULT, "fault", colour=VERMILLION)),
    share=0.8,
    state_colours=STATE_COLOURS,
)
NOW = Panel("Now", "readout", "readout", share=0.85)
STATUS = Panel("Status", "status", "status", share=0.8)
RESULTS = Panel("Results", "table", "results", share=0.75)
MESSAGES = Panel("Messages", "log", LOG, share=0.75)
NEWS = (RESULTS, MESSAGES)
VALUES = (NOW, RESULTS)


def pressure_panel(title: str) -> Panel:
    """Set-point and measured pressure."""
    channels = (
        Channel(SET_POINT, "pressure, set-point", "kPa", ORANGE, step=True),
        Channel(PRESSURE, "pressure, measured", "kPa", SKY),
    )
    return Panel(title, "series", "pressure", channels, share=1.6)


def isometric_layout(pressure_max_kpa: float = 500.0, force_max_n: float = 100.0) -> LiveLayout:
    """The layout of an isometric test: curves on the left; points, camera and readings right.

    Args:
        pressure_max_kpa: highest pressure of the protocol, for the axis of the points.
        force_max_n: highest expected force; the axis is extended if necessary.
    """
    force = Panel(
        "Force (N)",
        "series",
        "force",
        (Channel(FORCE, "force, measured", "N", GREEN, digits=2),),
        share=1.5,
    )
    length = Panel(
        "Length (mm)",
        "series",
        "length",
        (
            Channel(SET_LENGTH, "length, set", "mm", ORANGE, step=True, digits=2),
            Channel(LENGTH, "length, measured", "mm", YELLOW, digits=3),
        ),
    )
    points = Panel(
        "Settled points: force (N) against pressure (kPa), one colour per length",
        "points",
        "points",
        (Channel(POINTS, "force", "N"),),
        share=1.5,
        x_axis=Axis("pressure (kPa)", 0.0, pressure_max_kpa),
        y_axis=Axis("force (N)", 0.0, force_max_n),
    )
    camera = Panel(
        "Camera with measured edges",
        "camera",
        CAMERA,
        x_axis=Axis("x (px)", 0.0, 640.0),
        y_axis=Axis("y (px)", 0.0, 480.0),
    )
    left = (pressure_panel("Pressure (kPa)"), force, length, VALVES, STATES)
    return LiveLayout(
        title="Isometric test",
        columns=(left, (STATUS, points, (camera, NOW), NEWS)),
        shares=(1.0, 1.0),
        window_s=60.0,
        feeds=(*PRESSURE_FEEDS, *VALVE_FEEDS, Feed(FORCE, "balance", "zeroed_n")),
        event_feeds=(
            EventFeed(SET_LENGTH, "command", "length_mm"),
            EventFeed(LENGTH, "length", "pixels", quantity="length_mm", only="trusted"),
            *STATE_FEEDS,
        ),
        points=(PointFeed(POINTS, x=("valve", "pressure_kpa"), y=("balance", "force_n")),),
        camera=CAMERA,
    )


def without_camera(layout: LiveLayout) -> LiveLayout:
    """The layout of a test that takes no pictures: no picture, no length from one.

    A length that an instrument reads is drawn all the same, as a series that was not foreseen.
    """

    def kept(panel: Panel) -> Panel:
        return replace(panel, channels=tuple(c for c in panel.channels if c.path != LENGTH))

    columns: list[tuple[Panel | tuple[Panel, ...], ...]] = []
    for column in layout.columns:
        rows: list[Panel | tuple[Panel, ...]] = []
        for entry in column:
            row = (entry,) if isinstance(entry, Panel) else entry
            row = tuple(kept(panel) for panel in row if panel.kind != "camera")
            if row:
                rows.append(row[0] if len(row) == 1 else row)
        columns.append(tuple(rows))
    return replace(layout, columns=tuple(columns))


def edge_lines(gap: GapMeasurement, length_mm: float | None = None) -> list[Line]:
    """Overlay of a frame: both measured edges, and the gap with its length.

    Empty if no gap was found. If the gap is not trusted, the reason replaces the length.
    """
    lines: list[Line] = []
    for edge, name in ((gap.left, "left edge"), (gap.right, "right edge")):
        if edge is None:
            continue
        ends = [
            (edge.x_mid + edge.slope * (y - edge.y_mid), float(y)) for y in (edge.top, edge.bottom)
        ]
        lines.append((ends[0], ends[1], name))
    if gap.left is not None and gap.right is not None:
        if not gap.trusted:
            text = f"not trusted: {gap.reason}"
        elif length_mm is None:
            text = f"{gap.pixels:.2f} px"
        else:
            text = f"{gap.pixels:.2f} px = {length_mm:.3f} mm"
        y = (gap.left.y_mid + gap.right.y_mid) / 2.0
        lines.append(((gap.left.x_mid, y), (gap.right.x_mid, y), text))
    return lines


def profile_lines(gray: npt.NDArray[np.uint8], region: Box) -> list[Line]:
    """Region, column profile and the columns that the macro's threshold marks, without labels.

    The base line of the profile is the lower border of the region; the full grey scale is a
    quarter of its height. A bar marks columns above the threshold. Empty without a region.
    """
    left, top, width, height = region
    if width == 0:
        return []
    right, bottom = left + width, top + height
    box = [(left, top), (right, top), (right, bottom), (left, bottom)]
    lines: list[Line] = [(_point(box[k]), _point(box[(k + 1) % 4]), "") for k in range(4)]
    levels = gray[top:bottom, left:right].mean(axis=0)
    step = max(1, width // PROFILE_POINTS)
    x = left + np.arange(0, width, step)
    y = bottom - 4 - levels[::step] * (height / 4 / 255)
    lines += [
        ((float(x[k]), float(y[k])), (float(x[k + 1]), float(y[k + 1])), "")
        for k in range(len(x) - 1)
    ]
    marked = np.flatnonzero(np.diff(np.concatenate(([0], 255 - levels >= 130, [0]))))
    for first, last in zip(marked[::2], marked[1::2], strict=True):
        lines.append(((float(left + first), bottom - 2.0), (float(left + last), bottom - 2.0), ""))
    return lines


def _point(corner: tuple[int, int]) -> tuple[float, float]:
    return float(corner[0]), float(corner[1])


def measured_edges(run: Run) -> Callable[[bytes], list[Line]]:
    """Returns a function that measures a stored frame of a run and returns its overlay.

    Raises:
        RecordError: the camera settings in run.json are invalid.
    """
    from analysis.reduction.pictures import camera_of, decode, measure_stored

    camera = camera_of(run)

    def lines(jpeg: bytes) -> list[Line]:
        gray = decode(jpeg)
        if gray is None:
            return []
        gap = measure_stored(gray, camera)
        return [*edge_lines(gap), *profile_lines(gray, gap.region)]

    return lines
