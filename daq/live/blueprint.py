"""The viewer's arrangement of views for a ``LiveLayout``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from daq.live.chart import HEIGHT, WIDTH
from daq.live.layout import LiveLayout, Panel

TIMELINE = "time"
BACKGROUND = (18, 20, 22)
LEGEND = 0.35
"""Room for the legend before the oldest data, as a part of the time that is shown."""


def blueprint(
    layout: LiveLayout, *, extra: bool, whole_s: float | None = None, until_s: float | None = None
) -> Any:
    """The arrangement of views as a ``rerun.blueprint.Blueprint``.

    Args:
        layout: the panels.
        extra: add a panel for series that belong to no panel.
        whole_s: show the time from 0 to ``whole_s``; None shows the newest data in the layout's
            window.
        until_s: the time axis of a live view goes from 0 to this time; None: it moves with the
            newest data.
    """
    import rerun.blueprint as rrb

    span = _Span(layout.window_s, whole_s, until_s)
    columns = []
    for number, column in enumerate(layout.columns):
        rows, shares = [], []
        for entry in column:
            if isinstance(entry, Panel):
                rows.append(_view(entry, span))
                shares.append(entry.share)
            else:
                rows.append(
                    rrb.Horizontal(
                        *[_view(p, span) for p in entry], column_shares=[p.share for p in entry]
                    )
                )
                shares.append(max(p.share for p in entry))
        if number == 0 and extra:
            rows.append(_extra_view(layout, span))
            shares.append(1.0)
        columns.append(rrb.Vertical(*rows, row_shares=shares, name=f"column {number + 1}"))
    if extra and not columns:
        columns.append(_extra_view(layout, span))
    shares_x = list(layout.shares) if layout.shares else [1.0] * len(columns)
    return rrb.Blueprint(
        rrb.Horizontal(*columns, column_shares=shares_x, name=layout.title),
        rrb.TopPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(
            state="collapsed",
            timeline=TIMELINE,
            play_state="following",  # in a file: the end, where all points are visible
        ),
        auto_layout=False,
        auto_views=False,
    )


@dataclass(frozen=True)
class _Span:
    """The time range of the curves."""

    window_s: float
    whole_s: float | None
    until_s: float | None

    def ranges(self) -> Any:
        """The range of data to show."""
        import rerun.blueprint as rrb

        edge = rrb.TimeRangeBoundary
        start, end = edge.infinite(), edge.infinite()
        if self.whole_s is None:
            start, end = edge.cursor_relative(seconds=-self.window_s), edge.cursor_relative()
        return [rrb.VisibleTimeRange(TIMELINE, start=start, end=end)]

    def axis(self) -> Any:
        """The range of the time axis: that of the data, and before it room for the legend."""
        import rerun as rr
        import rerun.blueprint as rrb

        edge = rrb.TimeRangeBoundary
        fixed_s = self.until_s if self.whole_s is None else self.whole_s
        if fixed_s is None:
            start = edge.cursor_relative(seconds=-(1.0 + LEGEND) * self.window_s)
            end = edge.cursor_relative()
        else:
            start, end = edge.absolute(seconds=-LEGEND * fixed_s), edge.absolute(seconds=fixed_s)
        return rrb.TimeAxis(view_range=rr.TimeRange(start=start, end=end))


def _view(panel: Panel, span: _Span) -> Any:
    import rerun.blueprint as rrb

    where = {"origin": f"/{panel.origin}", "name": panel.title}
    if panel.kind == "series":
        return rrb.TimeSeriesView(
            **where,
            axis_x=span.axis(),
            axis_y=rrb.ScalarAxis(range=panel.y_range) if panel.y_range else None,
            plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.LeftTop),
            time_ranges=span.ranges(),
        )
    if panel.kind == "states":
        return rrb.StateTimelineView(**where, time_view=span.axis(), time_ranges=span.ranges())
    if panel.kind == "points":
        return rrb.Spatial2DView(
            **where,
            background=[*BACKGROUND, 255],
            visual_bounds=rrb.VisualBounds2D(
                x_range=[-90.0, WIDTH + 120.0], y_range=[-95.0, HEIGHT + 125.0]
            ),
        )
    if panel.kind == "camera":
        bounds = None
        if panel.x_axis is not None and panel.y_axis is not None:
            bounds = rrb.VisualBounds2D(
                x_range=[panel.x_axis.low, panel.x_axis.high],
                y_range=[panel.y_axis.low, panel.y_axis.high],
            )
        return rrb.Spatial2DView(**where, background=[*BACKGROUND, 255], visual_bounds=bounds)
    if panel.kind == "log":
        return rrb.TextLogView(
            **where,
            # The time column is too narrow; the text contains the time instead.
            columns=rrb.TextLogColumns(
                timeline_columns=[rrb.encodings.TimelineColumn(TIMELINE, visible=False)],
                text_log_columns=["loglevel", "body"],
            ),
        )
    return rrb.TextDocumentView(**where)


def _extra_view(layout: LiveLayout, span: _Span) -> Any:
    import rerun.blueprint as rrb

    known = [f"- /{panel.origin}/**" for panel in layout.panels]
    return rrb.TimeSeriesView(
        origin="/",
        contents=["+ /**", *known],
        name="Other series",
        axis_x=span.axis(),
        plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.LeftTop),
        time_ranges=span.ranges(),
    )
