"""Live layout of the tests of a joint: both pressures, angle and torque, results."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from analysis.layouts.layouts import (
    MESSAGES,
    POINTS,
    PRESSURE,
    SET_POINT,
    STATE_FEEDS,
    STATES,
    STATUS,
    VALUES,
)
from daq.live.layout import (
    BLUE,
    GREEN,
    ORANGE,
    PURPLE,
    SKY,
    VERMILLION,
    Axis,
    Channel,
    Feed,
    LiveLayout,
    Panel,
)

SET_POINT_B = "pressure/set_point_b_kpa"
PRESSURE_B = "pressure/measured_b_kpa"
ANGLE = "angle/measured_deg"
TORQUE = "torque/measured"
TORQUES = "torques/result"


def joint_layout(
    title: str, parameters: Mapping[str, Any], result: str, torques: bool = False
) -> LiveLayout:
    """Pressures, angle and torque on the left, results against the differential pressure right.

    Args:
        title: of the test.
        parameters: of run.json; ``instruments`` names those of angle and torque.
        result: axis label of the results.
        torques: a second chart for the torques of a locked joint.
    """
    pressures = Panel(
        "Pressures (kPa)",
        "series",
        "pressure",
        (
            Channel(SET_POINT, "pressure a, set-point", "kPa", ORANGE, step=True),
            Channel(PRESSURE, "pressure a, measured", "kPa", SKY),
            Channel(SET_POINT_B, "pressure b, set-point", "kPa", VERMILLION, step=True),
            Channel(PRESSURE_B, "pressure b, measured", "kPa", BLUE),
        ),
        share=1.6,
    )
    angle = Panel(
        "Angle (degrees)", "series", "angle",
        (Channel(ANGLE, "angle, measured", "deg", GREEN, digits=2),), share=1.5,
    )  # fmt: skip
    feeds = [
        Feed(SET_POINT, "valve", "target_kpa"),
        Feed(PRESSURE, "valve", "pressure_kpa"),
        Feed(SET_POINT_B, "valve_b", "target_kpa"),
        Feed(PRESSURE_B, "valve_b", "pressure_b_kpa"),
    ]
    left = [pressures, angle]
    names: Mapping[str, str] = parameters.get("instruments") or {}
    if names.get("angle"):
        feeds.append(Feed(ANGLE, names["angle"], "angle_deg"))
    if names.get("torque"):
        force = names["torque"] == "load_cell"
        what, unit = ("Force on the lever", "N") if force else ("Torque", "N m")
        channel = Channel(TORQUE, f"{what.lower()}, measured", unit, PURPLE, digits=4)
        left.append(Panel(f"{what} ({unit})", "series", "torque", (channel,)))
        feeds.append(Feed(TORQUE, names["torque"], "force_n" if force else "torque_n_m"))
    # The difference of one muscle alone is its pressure. [0] only would be an axis without width.
    given = [*(parameters.get("difference_kpa") or ()), *(parameters.get("alone_kpa") or ())]
    widest = max((abs(float(d)) for d in given), default=0.0) or 100.0
    charts = [_chart(POINTS, result, widest)]
    if torques and names.get("torque"):
        charts.append(_chart(TORQUES, f"{what} ({unit})", widest))
    return LiveLayout(
        title=title,
        columns=((*left, STATES, MESSAGES), (STATUS, *charts, VALUES)),
        shares=(1.0, 1.0),
        window_s=30.0,
        feeds=tuple(feeds),
        event_feeds=STATE_FEEDS,
    )


def _chart(path: str, result: str, widest_kpa: float) -> Panel:
    """Results against the differential pressure."""
    return Panel(
        f"{result} against differential pressure (kPa)",
        "points",
        path.split("/")[0],
        (Channel(path, result),),
        share=1.2,
        x_axis=Axis("difference (kPa)", -widest_kpa, widest_kpa),
        y_axis=Axis(result, -0.1, 0.1),
    )
