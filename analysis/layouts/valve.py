"""Live layouts of the valve tests."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from analysis.layouts.layouts import (
    MESSAGES,
    POINTS,
    PRESSURE_FEEDS,
    STATE_FEEDS,
    STATES,
    STATUS,
    VALUES,
    VALVE_FEEDS,
    VALVES,
    pressure_panel,
)
from daq.live.layout import GREEN, YELLOW, Axis, Channel, Feed, LiveLayout, Panel

VELOCITY = "flow/velocity_m_s"
VOLTAGE = "supply/voltage_v"


def valve_layout(
    title: str,
    parameters: Mapping[str, Any],
    *,
    flow: bool = False,
    voltage: bool = False,
    window_s: float = 30.0,
    result_axis: tuple[str, float] | None = None,
) -> LiveLayout:
    """The layout of a valve test: pressure and commands on the left, results on the right.

    Args:
        title: of the test.
        parameters: of run.json.
        flow: show the air velocity.
        voltage: show the voltage of the solenoids.
        window_s: time range of the curves.
        result_axis: label and upper limit of the results; default that of the parameters.
    """
    feeds = [*PRESSURE_FEEDS, *VALVE_FEEDS]
    right: list[Panel] = []
    if flow:
        velocity = Channel(VELOCITY, "air velocity, measured", "m/s", GREEN, digits=2)
        right.append(Panel("Air velocity (m/s)", "series", "flow", (velocity,), share=1.2))
        feeds.append(Feed(VELOCITY, "flow", "velocity_m_s"))
    if voltage:
        volts = Channel(VOLTAGE, "voltage of the solenoids", "V", YELLOW, step=True, digits=2)
        right.append(Panel("Voltage of the solenoids (V)", "series", "supply", (volts,), share=1.2))
        feeds.append(Feed(VOLTAGE, "supply", "voltage_v"))
    result = result_axis or parameters.get("result_axis")
    if result:
        label, high = result
        top = float(max(parameters.get("pressures_kpa") or [600.0]))
        right.append(
            Panel(
                f"{label} against pressure (kPa)",
                "points",
                "points",
                (Channel(POINTS, label),),
                share=1.5,
                x_axis=Axis("pressure (kPa)", 0.0, top),
                y_axis=Axis(label, 0.0, float(high)),
                reference="thesis",
            )
        )
    left = (pressure_panel("Pressure between the valves (kPa)"), VALVES, STATES, MESSAGES)
    return LiveLayout(
        title=title,
        columns=(left, (STATUS, *right, VALUES)),
        shares=(1.0, 1.0),
        window_s=window_s,
        feeds=tuple(feeds),
        event_feeds=STATE_FEEDS,
    )
