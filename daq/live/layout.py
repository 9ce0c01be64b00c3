"""What the live view shows, described by whoever knows the test: panels, names, units, colours.

Nothing here imports the viewer. The same description serves the live view and the view
file made from a finished run, so both look alike.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Colour = tuple[int, int, int]
Kind = Literal["series", "states", "points", "camera", "log", "readout"]
Reduce = Literal["minmax", "mean"]

# Okabe and Ito's palette for colour-blind readers; its black is a light grey here because
# the viewer's ground is dark. Ordered so that neighbours differ in lightness too.
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

_KINDS = ("series", "states", "points", "camera", "log", "readout")


@dataclass(frozen=True)
class Channel:
    """One curve, lane or cloud of points.

    Args:
        path: where it lives, ``panel/name_unit``; what ``LiveView.series`` is called with.
        label: the name in the legend.
        unit: unit for the read-out ("kPa"); empty where there is none.
        colour: red, green, blue; None takes the next of ``PALETTE``. In a states panel: of
            every text that ``state_colours`` does not name; None leaves that to the viewer.
        reduce: how 1 kHz becomes 100 Hz: both extremes of each bin, or its mean.
        step: draw as a staircase (set-points, states) instead of joining the points.
        digits: decimals in the read-out.
        readout: whether its newest value stands in the read-out panel.
    """

    path: str
    label: str
    unit: str = ""
    colour: Colour | None = None
    reduce: Reduce = "minmax"
    step: bool = False
    digits: int = 1
    readout: bool = True


@dataclass(frozen=True)
class Axis:
    """An axis of a points panel: its title with unit, and the range it always covers."""

    title: str
    low: float
    high: float


@dataclass(frozen=True)
class Panel:
    """One view on the screen.

    Args:
        title: shown above it, with the unit.
        kind: what it draws: series (against time), states (lanes against time), points
            (y against x), camera, log, readout (newest values in figures).
        origin: first part of the paths it shows; anything logged under it appears here.
        channels: what is known of it beforehand. More may arrive at run time.
        share: height (or width) relative to its neighbours.
        y_range: fixed vertical range of a series panel, or None for automatic.
        x_axis, y_axis: axes of a points panel; of a camera panel the extent of its frames
            in pixels, if it is known.
        state_colours: (text, colour) pairs of a states panel.
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

    def __post_init__(self) -> None:
        if self.kind not in _KINDS:
            raise ValueError(f"panel {self.title!r}: kind {self.kind!r} is not one of {_KINDS}")
        if self.kind == "points" and (self.x_axis is None or self.y_axis is None):
            raise ValueError(f"panel {self.title!r}: a points panel needs x_axis and y_axis")


@dataclass(frozen=True)
class Feed:
    """Where the record holds a channel's values: a column of a stream in engineering units.

    Args:
        path: the channel's path.
        stream, column: as ``daq.store.derive.engineering`` names them.
        scale: factor into the channel's unit.
    """

    path: str
    stream: str
    column: str
    scale: float = 1.0


@dataclass(frozen=True)
class EventFeed:
    """Where the record's events hold a channel's values or states.

    Args:
        path: the channel's path; in a states panel the field is shown as text.
        kind, field: which events, and which of their fields.
        quantity: calibration that turns the field into the channel's unit; None for none.
        only: name of a field that must be true.
    """

    path: str
    kind: str
    field: str
    quantity: str | None = None
    only: str | None = None


@dataclass(frozen=True)
class PointFeed:
    """Which events become settled points.

    Each event of ``kind`` gives one: the means of two columns over the rows it names
    (``valve_seq``, ``balance_rows``), or in an imported run its row of the ``points`` stream.

    Args:
        path: of the points panel's channel.
        x, y: (stream, column) as ``daq.store.derive.engineering`` names them; of the stream
        "camera",
            the mean over the event's ``frames`` of what ``length`` events say of them.
        label: format over the event's fields; the curve the point belongs to.
        needs: a field without which an event gives no point here.
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
        columns: panels of each column, top to bottom. A tuple of panels inside a column
            stands side by side.
        shares: widths of the columns.
        window_s: how much of the past the curves show while live.
        feeds, event_feeds, points: where the record holds the same values (for view files).
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
        """Every panel, in reading order."""
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
        """The panel that shows ``path``, or None if no panel was planned for it."""
        for panel in self.panels:
            if path == panel.origin or path.startswith(panel.origin + "/"):
                return panel
        return None
