"""The arrangement of views on the screen, from a ``LiveLayout``."""

from __future__ import annotations

from typing import Any

from daq.layout import LiveLayout, Panel
from daq.liveview_chart import HEIGHT, WIDTH

TIMELINE = "time"
GROUND = (18, 20, 22)


def blueprint(layout: LiveLayout, *, live: bool, extra: bool) -> Any:
    """The arrangement of views as a ``rerun.blueprint.Blueprint``.

    Args:
        layout: the panels.
        live: follow the newest data through the layout's window; else show all time.
        extra: add a panel for series that no panel was planned for.
    """
    import rerun.blueprint as rrb

    window_s = layout.window_s if live else None
    columns = []
    for number, column in enumerate(layout.columns):
        rows, shares = [], []
        for entry in column:
            if isinstance(entry, Panel):
                rows.append(_view(entry, window_s))
                shares.append(entry.share)
            else:
                rows.append(
                    rrb.Horizontal(
                        *[_view(p, window_s) for p in entry],
                        column_shares=[p.share for p in entry],
                    )
                )
                shares.append(max(p.share for p in entry))
        if number == 0 and extra:
            rows.append(_extra_view(layout, window_s))
            shares.append(1.0)
        columns.append(rrb.Vertical(*rows, row_shares=shares, name=f"column {number + 1}"))
    if extra and not columns:
        columns.append(_extra_view(layout, window_s))
    shares_x = list(layout.shares) if layout.shares else [1.0] * len(columns)
    return rrb.Blueprint(
        rrb.Horizontal(*columns, column_shares=shares_x, name=layout.title),
        rrb.TopPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(
            state="collapsed",
            timeline=TIMELINE,
            play_state="following",  # of a file: stands at its end, where all points are
        ),
        auto_layout=False,
        auto_views=False,
    )


def _time_ranges(window_s: float | None) -> Any:
    if window_s is None:
        return None
    import rerun.blueprint as rrb

    edge = rrb.TimeRangeBoundary.cursor_relative
    return [rrb.VisibleTimeRange(TIMELINE, start=edge(seconds=-window_s), end=edge())]


def _view(panel: Panel, window_s: float | None) -> Any:
    import rerun.blueprint as rrb

    where = {"origin": f"/{panel.origin}", "name": panel.title}
    if panel.kind == "series":
        return rrb.TimeSeriesView(
            **where,
            axis_y=rrb.ScalarAxis(range=panel.y_range) if panel.y_range else None,
            plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.LeftTop),
            time_ranges=_time_ranges(window_s),
        )
    if panel.kind == "states":
        return rrb.StateTimelineView(**where, time_ranges=_time_ranges(window_s))
    if panel.kind == "points":
        return rrb.Spatial2DView(
            **where,
            background=[*GROUND, 255],
            visual_bounds=rrb.VisualBounds2D(
                x_range=[-90.0, WIDTH + 120.0], y_range=[-70.0, HEIGHT + 95.0]
            ),
        )
    if panel.kind == "camera":
        return rrb.Spatial2DView(**where, background=[*GROUND, 255])
    if panel.kind == "log":
        return rrb.TextLogView(
            **where,
            # The time column is too narrow to read, so the text carries the time.
            columns=rrb.TextLogColumns(
                timeline_columns=[rrb.encodings.TimelineColumn(TIMELINE, visible=False)],
                text_log_columns=["loglevel", "body"],
            ),
        )
    return rrb.TextDocumentView(**where)


def _extra_view(layout: LiveLayout, window_s: float | None) -> Any:
    import rerun.blueprint as rrb

    known = [f"- /{panel.origin}/**" for panel in layout.panels]
    return rrb.TimeSeriesView(
        origin="/",
        contents=["+ /**", *known],
        name="Other series",
        plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.LeftTop),
        time_ranges=_time_ranges(window_s),
    )
