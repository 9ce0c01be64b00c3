"""Layout of the view of a recording of a controller of one's own."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from analysis.layouts.layouts import MESSAGES, NOW, SET_POINT
from daq.live.layout import (
    GREEN,
    ORANGE,
    PURPLE,
    SKY,
    YELLOW,
    Channel,
    EventFeed,
    Feed,
    LiveLayout,
    Panel,
)

STREAM = "columns"
LABELS = {
    "pressure_kpa": "pressure", "force_n": "force", "length_mm": "length",
    "temperature_c": "temperature",
}  # fmt: skip
UNITS = {"pressure_kpa": "kPa", "force_n": "N", "length_mm": "mm", "temperature_c": "°C"}
_COLOURS = {"pressure_kpa": SKY, "force_n": GREEN, "length_mm": YELLOW, "temperature_c": PURPLE}


def recording_layout(parameters: Mapping[str, Any]) -> LiveLayout:
    """One panel per channel, as ``channels`` of the parameters names them; all where it does not.

    Args:
        parameters: of run.json.
    """
    named = [name for name in parameters.get("channels") or LABELS if name in LABELS]
    sets = "pressure_kpa" in named
    panels, feeds = [], []
    for name in named:
        label, unit = LABELS[name], UNITS[name]
        path = f"{label}/recorded"
        channels = [Channel(path, f"{label}, recorded", unit, _COLOURS[name], digits=2)]
        if name == "pressure_kpa":
            channels.append(Channel(SET_POINT, "set-point sent", unit, ORANGE, step=True))
        panels.append(Panel(f"{label.capitalize()} ({unit})", "series", label, tuple(channels)))
        feeds.append(Feed(path, STREAM, name))
    return LiveLayout(
        title="Recording",
        columns=(tuple(panels), (NOW, MESSAGES)),
        shares=(2.0, 1.0),
        feeds=tuple(feeds),
        event_feeds=(EventFeed(SET_POINT, "command", "pressure_kpa"),) if sets else (),
    )
