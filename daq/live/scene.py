"""Draws a layout into a Rerun recording, for the live view and the view file.

Rerun is imported when a ``Scene`` is created, never at import of this module. Calls here may
block or raise; for a running test they are made in a process of their own (`daq.live.screen`).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from daq.live.blueprint import TIMELINE, blueprint
from daq.live.chart import Chart
from daq.live.layout import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PALETTE,
    PURPLE,
    SKY,
    VERMILLION,
    YELLOW,
    Channel,
    Colour,
    LiveLayout,
    Panel,
    channel_of,
)

APPLICATION = "pamrig"
Floats = npt.NDArray[np.float64]
Line = tuple[tuple[float, float], tuple[float, float], str]

FRAME_COLOUR = (130, 135, 140)
GRID_COLOUR = (45, 49, 53)
TEXT_COLOUR = (215, 215, 215)
EXTRA_COLOURS = (PURPLE, VERMILLION, SKY, YELLOW, ORANGE, GREEN, BLUE, GREY)
MOST_STATES = 200  # limit of texts with their own colour per lane
FIRST_S = 15.0  # end of the time axis when a test begins
TABLE_ROWS = 9  # the newest results that a table shows


LABEL_HEIGHT = 56.0  # of a label over a frame, in pixels of the frame


def label_places(lines: list[Line]) -> list[tuple[float, float]]:
    """Of a steep line above its upper end, each lower than the one before; of a flat one below it.

    Two edges may be closer to each other than their labels are wide.
    """
    places, steep = [], 0
    for a, b, _ in lines:
        if abs(b[1] - a[1]) > abs(b[0] - a[0]):
            top = min(a, b, key=lambda end: end[1])
            places.append((top[0], top[1] - 28.0 + steep * LABEL_HEIGHT))
            steep += 1
        else:
            places.append(((a[0] + b[0]) / 2.0, max(a[1], b[1]) + 6.0))
    return places


class Scene:
    """Draws series, points, pictures, states and messages into a ``rerun.RecordingStream``."""

    def __init__(self, rec: Any, layout: LiveLayout, live: bool = False) -> None:
        """Draw into ``rec``; of a ``live`` test the time axis grows until it is full."""
        import rerun as rr

        self._rr, self._rec = rr, rec
        self._layout = layout
        self._known = set(layout.channels)
        self._more: dict[str, Channel] = {}
        self._results: dict[str, list[tuple[str, float, float]]] = {}
        self._counts: dict[str, int] = {}
        self._charts: dict[str, Chart] = {}
        self._extra = False
        ends = [end for end in (FIRST_S, layout.window_s) if end <= layout.window_s]
        self._ends = ends if live else []  # of the time axis, before it moves with the data
        self._state_colours: dict[str, dict[str, Colour]] = {}
        self.newest: dict[str, float] = {}
        self._last_s: dict[str, float] = {}
        self.states: dict[str, str] = {}
        self.newest_s = 0.0

    # ------------------------------------------------------------------ set-up

    def start(self) -> None:
        """Send the blueprint, the style of every known channel and empty charts."""
        self._arrange()
        for index, (path, channel) in enumerate(self._layout.channels.items()):
            panel = self._layout.panel_of(path)
            if panel is not None and panel.kind == "series":
                self._style(channel, PALETTE[index % len(PALETTE)])
        for panel in self._layout.panels:
            if panel.kind == "points":
                self._axes(panel, self._chart(panel))
            if panel.kind == "states":
                for channel in panel.channels:
                    self._state_colours[channel.path] = dict(panel.state_colours)
                    self._state_style(channel.path)
            if panel.kind == "table":
                self._table(panel.origin)
            if panel.kind == "status":
                self.status(panel.origin, 0.0, "# STARTING")

    def _style(self, channel: Channel, colour: Colour) -> None:
        self._rec.log(
            channel.path,
            self._rr.SeriesLines(
                names=channel.legend,
                colors=[channel.colour or colour],
                widths=1.2 if channel.step else 2.2,
                interpolation_mode="StepAfter" if channel.step else "Linear",
                # Where several points fall on one pixel: steps as they are, peaks of others kept.
                aggregation_policy="Off" if channel.step else "MinMax",
            ),
            static=True,
        )

    def _state_style(self, path: str) -> None:
        colours = self._state_colours[path]
        if colours:
            texts = list(colours)
            style = self._rr.StateConfiguration(
                values=texts, labels=texts, colors=list(colours.values())
            )
            self._rec.log(path, style, static=True)

    # ------------------------------------------------------------------- drawing

    def series(self, path: str, time_s: Floats, values: Floats) -> None:
        """Add a piece of a curve; an unknown path gets a style and, if needed, a panel."""
        if len(time_s) == 0:
            return
        if path not in self._known:
            self._add_path(path)
        time_ns = np.round(np.asarray(time_s) * 1e9).astype("timedelta64[ns]")
        self._rec.send_columns(
            path,
            indexes=[self._rr.TimeColumn(TIMELINE, duration=time_ns)],
            columns=self._rr.Scalars.columns(scalars=values),
        )
        self.newest[path] = float(values[-1])
        self._last_s[path] = float(time_s[-1])
        self.newest_s = max(self.newest_s, float(time_s[-1]))
        if self._ends and self.newest_s > self._ends[0]:
            self._ends = [end for end in self._ends if end >= self.newest_s]
            self._arrange()

    def _add_path(self, path: str) -> None:
        self._known.add(path)
        panel = self._layout.panel_of(path)
        used = [c.colour for c in panel.channels] if panel is not None else []
        used += [c.colour for c in self._more.values() if self._layout.panel_of(c.path) == panel]
        free = [colour for colour in EXTRA_COLOURS if colour not in used] or list(PALETTE)
        channel = self._more[path] = channel_of(path, free[0])
        self._style(channel, free[0])
        if panel is None and not self._extra:
            self._extra = True
            self._arrange()

    def _arrange(self) -> None:
        until_s = self._ends[0] if self._ends else None
        self._rec.send_blueprint(blueprint(self._layout, extra=self._extra, until_s=until_s))

    def points(self, path: str, time_s: float, label: str, x: Floats, y: Floats) -> None:
        """Add points to a chart; paths without a points panel are ignored."""
        panel = self._layout.panel_of(path)
        if panel is None or panel.kind != "points":
            return
        self._at(time_s)
        chart = self._chart(panel)
        if panel.reference is None or not label.endswith(panel.reference):
            self._add_results(panel, label, x, y)
        for table in self._layout.panels:
            if table.kind == "table":
                self._table(table.origin)
        if chart.add(label, x, y):
            self._axes(panel, chart)
            for name in chart.curves:
                self._curve(panel, chart, name)
        else:
            self._curve(panel, chart, label)
        names, at = chart.label_positions()
        self._rec.log(
            f"{panel.origin}/legend",
            self._rr.Points2D(
                at,
                radii=0.1,
                colors=[chart.curves[n].colour for n in names],
                labels=names,
                show_labels=True,
            ),
        )

    def _add_results(self, panel: Panel, label: str, x: Floats, y: Floats) -> None:
        rows = self._results[panel.origin] = self._results.pop(panel.origin, [])  # now the newest
        rows += [(label, float(a), float(b)) for a, b in zip(x, y, strict=True)]
        self._counts[panel.origin] = self._counts.get(panel.origin, 0) + len(x)
        del rows[:-TABLE_ROWS]

    def _table(self, origin: str) -> None:
        """The newest results of every chart as rows, the newest first; so are the charts."""
        order = list(self._results)
        charts = [panel for panel in self._layout.panels if panel.kind == "points"]
        charts.sort(key=lambda p: order.index(p.origin) if p.origin in order else -1, reverse=True)
        parts = []
        for panel in charts:
            if panel.x_axis is None or panel.y_axis is None:
                continue
            rows, count = self._results.get(panel.origin, []), self._counts.get(panel.origin, 0)
            lines = [
                f"| no. | curve | {panel.x_axis.title} | {panel.y_axis.title} |",
                "|--:|:--|--:|--:|",
            ]
            lines += [
                f"| {count - k} | {label} | {panel.x_axis.text(x)} | {panel.y_axis.text(y)} |"
                for k, (label, x, y) in enumerate(rows[: -TABLE_ROWS // len(charts) - 1 : -1])
            ]
            parts.append("\n".join(lines if rows else [*lines, "| | none yet | | |"]))
        body = "\n\n".join(parts)
        self._rec.log(f"{origin}/newest", self._rr.TextDocument(body, media_type="text/markdown"))

    def status(self, path: str, time_s: float, text: str) -> None:
        """Show a text in Markdown in the panel of ``path`` from ``time_s`` on."""
        self._at(time_s)
        self._rec.log(f"{path}/now", self._rr.TextDocument(text, media_type="text/markdown"))

    def _chart(self, panel: Panel) -> Chart:
        if panel.origin not in self._charts:
            assert panel.x_axis is not None
            assert panel.y_axis is not None
            self._charts[panel.origin] = Chart(panel.x_axis, panel.y_axis)
        return self._charts[panel.origin]

    def _curve(self, panel: Panel, chart: Chart, label: str) -> None:
        curve = chart.curves[label]
        if not curve.x:
            return
        name = self._rr.escape_entity_path_part(label)
        rr, base = self._rr, f"{panel.origin}/curves/{name}"
        at = chart.place(np.asarray(curve.x), np.asarray(curve.y))
        self._rec.log(
            f"{base}/line",
            rr.LineStrips2D(
                [chart.line(label)], colors=[curve.colour], radii=rr.Radius.ui_points(0.8)
            ),
        )
        self._rec.log(
            f"{base}/points",
            rr.Points2D(at, colors=[curve.colour], radii=rr.Radius.ui_points(3.0), draw_order=40.0),
        )

    def _axes(self, panel: Panel, chart: Chart) -> None:
        rr, drawing = self._rr, chart.drawing()
        colours = [FRAME_COLOUR] + [GRID_COLOUR] * (len(drawing.strips) - 1)
        self._rec.log(
            f"{panel.origin}/axes/grid",
            rr.LineStrips2D(
                drawing.strips, colors=colours, radii=rr.Radius.ui_points(0.5), draw_order=1.0
            ),
            static=True,
        )
        for part, at, texts in (
            ("ticks", drawing.tick_at, drawing.tick_text),
            ("titles", drawing.title_at, drawing.title_text),
        ):
            self._rec.log(
                f"{panel.origin}/axes/{part}",
                rr.Points2D(at, radii=0.1, colors=[TEXT_COLOUR], labels=texts, show_labels=True),
                static=True,
            )

    def image(self, path: str, time_s: float, jpeg: bytes, lines: list[Line]) -> None:
        """Show a camera frame with the measured lines.

        Lines with a name come first and are prominent; nameless ones (a profile, a region) are
        thin.
        """
        rr = self._rr
        self._at(time_s)
        self._rec.log(f"{path}/frame", rr.EncodedImage(contents=jpeg, media_type="image/jpeg"))
        if not lines:
            self._rec.log(f"{path}/edges", rr.Clear(recursive=True))
            return
        named = [line for line in lines if line[2]]
        plain = [line for line in lines if not line[2]]
        colours = [(ORANGE, PALETTE[0], GREY)[min(k, 2)] for k in range(len(named))]
        for part, group, colour, radius, order in (
            ("profile", plain, [PALETTE[2]], 0.6, 49.0),
            ("edges", named, colours, 1.2, 50.0),
        ):
            strips = [np.array([a, b], dtype=float) for a, b, _ in group]
            size = rr.Radius.ui_points(radius)
            lines_2d = rr.LineStrips2D(strips, colors=colour, radii=size, draw_order=order)
            self._rec.log(f"{path}/{part}", lines_2d)
        self._rec.log(
            f"{path}/edges/names",
            rr.Points2D(
                label_places(named),
                radii=0.1,
                colors=colours,
                labels=[text for _, _, text in named],
                show_labels=True,
                draw_order=51.0,
            ),
        )

    def state(self, path: str, time_s: float, text: str) -> None:
        """Change the state of a lane; an empty text ends the state."""
        channel, colours = self._layout.channels.get(path), self._state_colours.get(path)
        colour = channel.colour if channel is not None else None
        if text and colour and colours is not None and text not in colours:
            if len(colours) >= MOST_STATES:
                colours.pop(next(iter(colours)))
            colours[text] = colour
            self._state_style(path)
        self._at(time_s)
        self._rec.log(path, self._rr.StateChange(state=text or None))
        self.states[path] = text

    def text(self, path: str, time_s: float, text: str, level: str) -> None:
        """Add a line to the log."""
        self._at(time_s)
        colour = {"ERROR": VERMILLION, "WARN": ORANGE}.get(level, TEXT_COLOUR)
        self._rec.log(path, self._rr.TextLog(f"{time_s:.1f} s   {text}", level=level, color=colour))

    def hold_steps(self, behind_s: float = 0.0) -> None:
        """Extend every step curve to ``behind_s`` before the newest time.

        Live batches of different devices arrive up to some 10 ms apart. A step curve extended
        to the newest time could overtake its own next step.
        """
        until_s = self.newest_s - behind_s
        for path, value in list(self.newest.items()):
            channel = self._layout.channels.get(path)
            if np.isnan(value):  # there is no set-point to extend
                continue
            if channel is not None and channel.step and self._last_s[path] < until_s:
                self.series(path, np.array([until_s]), np.array([value]))

    def finish(self) -> None:
        """For a view file: extend step curves to the end and show the whole test."""
        self.hold_steps()
        self.readout()
        self._rec.send_blueprint(
            blueprint(self._layout, extra=self._extra, whole_s=max(self.newest_s, 1e-3))
        )

    def readout(self, note: str = "") -> None:
        """Show the newest values as text in every readout panel."""
        panels = [panel for panel in self._layout.panels if panel.kind == "readout"]
        if not panels:
            return
        rows = []
        for panel in self._layout.panels:
            for channel in panel.channels:
                if panel.kind == "series" and channel.readout:
                    rows.append((channel.label, self._value(channel)))
            rows += [
                (channel.label, self._value(channel))
                for channel in self._more.values()
                if self._layout.panel_of(channel.path) == panel
            ]
        body = "\n".join(f"| {name} | **{value or '-'}** |" for name, value in rows)
        head = f"| {self._layout.title} | {self.newest_s:.1f} s |\n|:--|:--|\n"
        self._at(self.newest_s)
        for panel in panels:
            self._rec.log(
                f"{panel.origin}/now",
                self._rr.TextDocument(head + body + f"\n\n{note}", media_type="text/markdown"),
            )

    def _value(self, channel: Channel) -> str:
        """The newest value with its unit; empty for none."""
        value = self.newest.get(channel.path, np.nan)
        return "" if np.isnan(value) else f"{value:.{channel.digits}f} {channel.unit}"

    def _at(self, time_s: float) -> None:
        self.newest_s = max(self.newest_s, time_s)
        self._rec.set_time(TIMELINE, duration=time_s)
