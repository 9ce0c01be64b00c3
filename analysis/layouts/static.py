"""Live layouts of the static tests."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from analysis.layouts.layouts import POINTS, SET_LENGTH, isometric_layout
from daq.live.layout import PURPLE, Axis, Channel, Feed, LiveLayout, Panel, PointFeed

TEMPERATURE = "temperature/measured_c"
LENGTH_POINTS = "lengths/length_mm"
LENGTHS = Axis("length (mm)", 50.0, 73.0)


def isobaric_layout(force_max_n: float = 100.0) -> LiveLayout:
    """Force against length, one colour per pressure; the length changes at constant pressure."""
    base = isometric_layout(force_max_n=force_max_n)
    points = replace(
        _panel(base, "points"),
        title="Settled points: force (N) against length (mm), one colour per pressure",
        x_axis=LENGTHS,
    )
    feed = PointFeed(
        POINTS, x=("camera", "length_mm"), y=("balance", "force_n"),
        label="{set_pressure_kpa:g} kPa",
    )  # fmt: skip
    pressure, force, length, valves, states = base.columns[0]
    left = (_with_share(length, 1.4), force, pressure, valves, states)
    return replace(
        base, title="Isobaric test", columns=(left, _with_points(base, points)), points=(feed,)
    )


def isotonic_layout(
    pressure_max_kpa: float = 600.0, label: str = "{mass_kg:g} kg", title: str = "Isotonic test"
) -> LiveLayout:
    """Camera picture and length, which is the result; without the balance."""
    base = isometric_layout(pressure_max_kpa=pressure_max_kpa)
    pressure, _, length, valves, states = base.columns[0]
    camera, now = base.columns[1][2]  # type: ignore[misc]
    points = _length_points(pressure_max_kpa)
    return replace(
        base,
        title=title,
        columns=(
            (_with_share(_not_set(length), 1.7), pressure, valves, states),
            (base.columns[1][0], points, (replace(camera, share=1.2), now), base.columns[1][3]),
        ),
        feeds=tuple(feed for feed in base.feeds if feed.stream != "balance"),
        points=(_length_feed(label),),
    )


def _not_set(length: Panel | tuple[Panel, ...]) -> Panel:
    """The panel of a length that nothing sets: a load hangs."""
    assert isinstance(length, Panel)
    return replace(length, channels=tuple(c for c in length.channels if c.path != SET_LENGTH))


def hysteresis_layout(
    lengths: Iterable[float], masses: Iterable[float], pressure_max_kpa: float = 600.0
) -> LiveLayout:
    """Loops: force against pressure, length against pressure, or both."""
    label = " to {cycle_max_kpa:g} kPa"
    if not list(lengths):
        title = "Hysteresis test under a load"
        return isotonic_layout(pressure_max_kpa, "{mass_kg:g} kg" + label, title)
    base = isometric_layout(pressure_max_kpa=pressure_max_kpa)
    points = replace(
        _panel(base, "points"),
        title="Loops: force (N) against pressure (kPa), one colour per length and cycle",
    )
    feed = replace(base.points[0], label="{set_length_mm:g} mm" + label, needs="set_length_mm")
    right = _with_points(base, points)
    feeds: tuple[PointFeed, ...] = (feed,)
    if list(masses):
        # Half the width each: longer titles would be cut.
        by_length = replace(points, title="Force (N) against pressure (kPa)")
        by_load = replace(
            _length_points(pressure_max_kpa), title="Length (mm) against pressure (kPa)"
        )
        right = _with_points(base, (by_length, by_load))
        feeds = (feed, _length_feed("{mass_kg:g} kg" + label))
    return replace(base, title="Hysteresis test", columns=(base.columns[0], right), points=feeds)


def isothermal_layout(pressure_max_kpa: float = 600.0) -> LiveLayout:
    """The isometric layout with the thermometer; points by length and temperature."""
    base = isometric_layout(pressure_max_kpa=pressure_max_kpa)
    warm = Panel(
        "Temperature (°C)", "series", "temperature",
        (Channel(TEMPERATURE, "temperature, measured", "°C", PURPLE, digits=2),),
    )  # fmt: skip
    points = replace(
        _panel(base, "points"),
        title="Settled points: force (N) against pressure (kPa), one colour per length and °C",
    )
    pressure, force, length, _, states = base.columns[0]
    feed = replace(base.points[0], label="{set_length_mm:g} mm, {set_temperature_c:g} °C")
    return replace(
        base,
        title="Isothermal test",
        columns=((warm, pressure, force, length, states), _with_points(base, points)),
        feeds=(
            *(f for f in base.feeds if not f.path.startswith("valves/")),
            Feed(TEMPERATURE, "thermometer", "temperature_c"),
        ),
        points=(feed,),
    )


Row = Panel | tuple[Panel, ...]


def _with_points(base: LiveLayout, points: Row) -> tuple[Row, ...]:
    """The right column of the isometric layout with another chart."""
    status, _, *rest = base.columns[1]
    return (status, points, *rest)


def _panel(layout: LiveLayout, kind: str) -> Panel:
    return next(panel for panel in layout.panels if panel.kind == kind)


def _with_share(panel: Panel | tuple[Panel, ...], share: float) -> Panel:
    assert isinstance(panel, Panel)
    return replace(panel, share=share)


def _length_points(pressure_max_kpa: float) -> Panel:
    return Panel(
        "Settled points: length (mm) against pressure (kPa), one colour per load",
        "points",
        LENGTH_POINTS.partition("/")[0],
        (Channel(LENGTH_POINTS, "length", "mm"),),
        share=1.5,
        x_axis=Axis("pressure (kPa)", 0.0, pressure_max_kpa),
        y_axis=LENGTHS,
    )


def _length_feed(label: str) -> PointFeed:
    return PointFeed(
        LENGTH_POINTS, x=("valve", "pressure_kpa"), y=("camera", "length_mm"),
        label=label, needs="mass_kg",
    )  # fmt: skip
