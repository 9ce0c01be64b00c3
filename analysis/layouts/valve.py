"""What the live view shows during the tests of the valve alone."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from analysis.layouts import layouts as paths
from daq.live.layout import (
    GREEN,
    ORANGE,
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

VELOCITY = "flow/velocity_m_s"
VOLTAGE = "supply/voltage_v"


def valve_layout(
    title: str,
    parameters: Mapping[str, Any],
    *,
    flow: bool = False,
    voltage: bool = False,
    window_s: float = 30.0,
) -> LiveLayout:
    """The screen of a valve test: pressure and commands left; what is measured right.

    Args:
        title: of the test.
        parameters: of run.json.
        flow: the rig's meter reads air velocity.
        voltage: the rig's supply reads the solenoids' voltage.
        window_s: how much of the past the curves show.
    """
    top = max(parameters.get("pressures_kpa") or [600.0])
    pressure = Panel(
        "Pressure between the valves (kPa)",
        "series",
        "pressure",
        (
            Channel(paths.SET_POINT, "asked for", "kPa", ORANGE, step=True),
            Channel(paths.PRESSURE, "measured", "kPa", SKY),
        ),
        share=1.6,
    )
    valves = Panel(
        "Valves, share of time commanded open (%)",
        "series",
        "valves",
        (
            Channel(paths.INLET, "inlet", "%", SKY, reduce="mean", digits=0),
            Channel(paths.OUTLET, "outlet", "%", VERMILLION, reduce="mean", digits=0),
        ),
        y_range=(-5.0, 105.0),
    )
    states = Panel(
        "Protocol",
        "states",
        "state",
        (Channel(paths.STATE, "state"), Channel(paths.FAULT, "fault", colour=VERMILLION)),
        share=0.8,
        state_colours=paths.STATE_COLOURS,
    )
    now = Panel("Now", "readout", "readout", share=0.85)
    log = Panel("Messages", "log", paths.LOG, share=0.6)
    feeds = [
        Feed(paths.SET_POINT, "valve", "setpoint_kpa"),
        Feed(paths.PRESSURE, "valve", "pressure_kpa"),
        Feed(paths.INLET, "valve", "inlet_cmd", scale=100.0),
        Feed(paths.OUTLET, "valve", "vent_cmd", scale=100.0),
    ]
    right: list[Panel] = []
    points: tuple[PointFeed, ...] = ()
    if flow:
        velocity = Channel(VELOCITY, "air velocity", "m/s", GREEN, digits=2)
        right.append(Panel("Air velocity (m/s)", "series", "flow", (velocity,), share=1.2))
        feeds.append(Feed(VELOCITY, "flow", "velocity_m_s"))
    if voltage:
        volts = Channel(VOLTAGE, "solenoids", "V", YELLOW, step=True, digits=2)
        right.append(Panel("Voltage of the solenoids (V)", "series", "supply", (volts,), share=1.2))
        feeds.append(Feed(VOLTAGE, "supply", "voltage_v"))
    result = parameters.get("result_axis")
    if result:
        label, high = result
        right.append(
            Panel(
                f"{label} against pressure (kPa)",
                "points",
                "points",
                (Channel(paths.POINTS, label),),
                share=1.5,
                x_axis=Axis("pressure (kPa)", 0.0, float(top)),
                y_axis=Axis(label, 0.0, float(high)),
            )
        )
    return LiveLayout(
        title=title,
        columns=((pressure, valves, states), (*right, now, log)),
        shares=(1.0, 1.0),
        window_s=window_s,
        feeds=tuple(feeds),
        event_feeds=(
            EventFeed(paths.STATE, "state", "state"),
            EventFeed(paths.FAULT, "fault", "text"),
        ),
        points=points,
    )
