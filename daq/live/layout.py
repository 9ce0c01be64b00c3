"""Description of the live view: panels, names, units, colours.

This module does not import the viewer. The live view and the view file of a finished run use
the same description, so both look alike.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

Colour = tuple[int, int, int]
Kind = Literal["series", "states", "points", "camera", "log", "readout", "status", "table"]
Reduce = Literal["minmax", "mean"]

# Okabe and Ito's colour-blind safe palette; light grey replaces black on the dark background.
# Neighbours also differ in lightness.
PALETTE: tuple[Colour, ...] = (
    (86, 180, 233),
    (230, 159, 0),
    (0, 158, 115),
    (240, 228, 66),
    (204, 121, 167),
    (213, 94, 0),
    (200, 200, 200),
    (0, 114, 178),
)
SKY, ORANGE, GREEN, YELLOW, PURPLE, VERMILLION, GREY, BLUE = PALETTE

_KINDS = get_args(Kind)
FINEST = 2500
"""A table of results shows this part of an axis."""


@dataclass(frozen=True)
class Channel:
    """One curve, state lane or set of points.

    Args:
        path: ``panel/name_unit``, the first argument of ``LiveView.series``.
        label: name in the legend.
        unit: unit in the readout ("kPa"); empty for none.
        colour: red, green, blue; None takes the next colour of ``PALETTE``. In a states panel,
            the colour of texts not in ``state_colours``; None leaves it to the viewer.
        reduce: reduction of 1 kHz to 100 Hz: min/max envelope or mean.
        step: draw as a step curve (set-points, states).
        digits: decimals in the readout.
        readout: show the newest value in the readout panel.
    """

    path: str
    label: str
    unit: str = ""
    colour: Colour | None = None
    reduce: Reduce = "minmax"
    step: bool = False
    digits: int = 1
    readout: bool = True

    @property
    def legend(self) -> str:
        """The name with its unit: ``force, measured (N)``."""
        return f"{self.label} ({self.unit})" if self.unit else self.label


UNITS = {
    "kpa": "kPa", "n": "N", "mm": "mm", "percent": "%", "v": "V", "c": "°C", "deg": "deg", "s": "s",
    "ms": "ms", "g": "g", "kg": "kg", "hz": "Hz",
}  # fmt: skip
"""Units by the last word of a path."""


def channel_of(path: str, colour: Colour | None = None) -> Channel:
    """A channel for a path that no panel knows: name and unit from its words.

    ``force/predicted_n`` becomes ``force, predicted (N)``.
    """
    words = path.replace("/", " / ").replace("_", " ").split()
    unit = UNITS.get(words[-1], "") if len(words) > 1 and words[-2] != "/" else ""
    name = " ".join(words[:-1] if unit else words).replace(" / ", ", ")
    return Channel(path, name, unit, colour, digits=2)


@dataclass(frozen=True)
class Axis:
    """An axis of a points panel: title with unit, and the minimum range.

    Attributes:
        log10: the values of the points, low and high are log10 of the quantity that the title
            names; ticks and the table of results show the quantity itself.
    """

    title: str
    low: float
    high: float
    log10: bool = False

    def quantity(self, value: float) -> float:
        """The quantity that a value of a point stands for."""
        return 10.0**value if self.log10 else value

    def text(self, value: float) -> str:
        """The quantity as text: to about 1/2500 of the axis; three digits on a logarithmic one."""
        quantity = self.quantity(value)
        if self.log10:
            decimals = max(2 - math.floor(value + 1e-9), 0)
            return f"{quantity:.{decimals}f}"
        decimals = max(-math.floor(math.log10((self.high - self.low) / FINEST)), 0)
        return f"{quantity:z.{decimals}f}".replace("-", "−")


@dataclass(frozen=True)
class Panel:
    """One view on the screen.

    Args:
        title: shown above it, with the unit.
        kind: series (values over time), states (lanes over time), points (y over x), camera,
            log, readout (newest values as text), status (state, progress and faults in large
            letters), or table (newest results as rows).
        origin: first part of its paths; the panel shows all data logged below it.
        channels: the known channels; others may follow at run time.
        share: height (or width) relative to its neighbours.
        y_range: fixed vertical range of a series panel, or None for automatic.
        x_axis, y_axis: axes of a points panel; for a camera panel the frame size in pixels, if
            known.
        state_colours: (text, colour) pairs of a states panel.
        reference: curves of a points panel whose names end with this were not measured; the table
            of results leaves them out.
    """

    title: str
    kind: Kind
    origin: str
    channels: tuple[Channel, ...] = ()
    share: float = 1.0
    y_range: tuple[float, float] | None = None
    x_axis: Axis | None = None
    y_axis: Axis | None = None
    state_colours: tuple[tuple[str, Colour], ...] = ()
    reference: str | None = None

    def __post_init__(self) -> None:
        if self.kind not in _KINDS:
            raise ValueError(f"panel {self.title!r}: kind {self.kind!r} is not one of {_KINDS}")
        if self.kind == "points" and (self.x_axis is None or self.y_axis is None):
            raise ValueError(f"panel {self.title!r}: a points panel needs x_axis and y_axis")


@dataclass(frozen=True)
class Feed:
    """Source of a channel's values in the record: a column of a stream.

    Args:
        path: the channel's path.
        stream, column: names as in ``daq.store.derive.engineering``.
        scale: factor to the channel's unit.
    """

    path: str
    stream: str
    column: str
    scale: float = 1.0


PREDICTION = "prediction"
"""Stream of what a plant predicted while the test ran, as it was drawn."""
PREDICTION_COLUMNS = {
    "row": "int64",
    "host_ns": "int64",
    "predicted_pressure_kpa": "float64",
    "predicted_force_n": "float64",
    "gap_share_valve_percent": "float64",
    "gap_share_muscle_percent": "float64",
}
PREDICTION_UNITS = {
    "host_ns": "ns",
    "predicted_pressure_kpa": "kPa",
    "predicted_force_n": "N",
    "gap_share_valve_percent": "%",
    "gap_share_muscle_percent": "%",
}
PREDICTION_FEEDS = (
    Feed("pressure/predicted_kpa", PREDICTION, "predicted_pressure_kpa"),
    Feed("force/predicted_n", PREDICTION, "predicted_force_n"),
    Feed("share of the gap/valve_and_chamber_percent", PREDICTION, "gap_share_valve_percent"),
    Feed("share of the gap/muscle_percent", PREDICTION, "gap_share_muscle_percent"),
)
"""Its curves; a row that has no value of a column has NaN there."""


@dataclass(frozen=True)
class EventFeed:
    """Source of a channel's values or states in the record: events.

    Args:
        path: the channel's path; a states panel shows the field as text.
        kind, field: the events and their field.
        quantity: calibration from the field to the channel's unit; None for none.
        only: name of a field that must be true.
    """

    path: str
    kind: str
    field: str
    quantity: str | None = None
    only: str | None = None


@dataclass(frozen=True)
class PointFeed:
    """Events that give settled points.

    Each event of ``kind`` gives one point: the means of two columns over the rows it names
    (``valve_seq``, ``balance_rows``), or in an imported run its row of the ``points`` stream.

    Args:
        path: of the points panel's channel.
        x, y: (stream, column) as in ``daq.store.derive.engineering``; for the stream "camera",
            the mean length of the event's ``frames`` from ``length`` events.
        label: format string for the event's fields; names the curve of the point.
        needs: a field without which an event gives no point.
    """

    path: str
    x: tuple[str, str]
    y: tuple[str, str]
    kind: str = "point"
    label: str = "{set_length_mm:g} mm"
    needs: str | None = None


@dataclass(frozen=True)
class LiveLayout:
    """The whole screen: columns of panels from left to right.

    Args:
        title: name of the test.
        columns: panels of each column, top to bottom. A tuple of panels is placed side by side.
        shares: widths of the columns.
        window_s: time span of the live curves, s.
        feeds, event_feeds, points: sources of the same values in the record, for view files.
        camera: path of the camera picture.
    """

    title: str
    columns: tuple[tuple[Panel | tuple[Panel, ...], ...], ...]
    shares: tuple[float, ...] = ()
    window_s: float = 60.0
    feeds: tuple[Feed, ...] = ()
    event_feeds: tuple[EventFeed, ...] = ()
    points: tuple[PointFeed, ...] = ()
    camera: str = "camera"

    @property
    def panels(self) -> tuple[Panel, ...]:
        """All panels, in reading order."""
        flat: list[Panel] = []
        for column in self.columns:
            for entry in column:
                flat.extend([entry] if isinstance(entry, Panel) else entry)
        return tuple(flat)

    @property
    def channels(self) -> dict[str, Channel]:
        """Known channels by path."""
        return {c.path: c for panel in self.panels for c in panel.channels}

    def panel_of(self, path: str) -> Panel | None:
        """The panel that shows ``path``, else None."""
        for panel in self.panels:
            if path == panel.origin or path.startswith(panel.origin + "/"):
                return panel
        return None
