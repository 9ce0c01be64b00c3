"""Live layouts of the standard tests of one muscle."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from analysis.layouts.layouts import POINTS, STATUS, isometric_layout, without_camera
from analysis.layouts.static import isotonic_layout
from daq.live.layout import Axis, Channel, LiveLayout, Panel


def blocked_layout(pressure_max_kpa: float) -> LiveLayout:
    """The isometric layout."""
    return replace(isometric_layout(pressure_max_kpa), title="Blocked force test")


def free_layout(pressure_max_kpa: float) -> LiveLayout:
    """The isotonic layout."""
    return isotonic_layout(pressure_max_kpa, "{mass_kg:g} kg", "Free contraction test")


def held_layout(title: str, parameters: Mapping[str, Any], loaded: bool) -> LiveLayout:
    """Force or length against the logarithm of time, beside the curves of a static test.

    Args:
        title: of the test.
        parameters: of run.json.
        loaded: a load hangs and the length is the result; otherwise the force is.
    """
    base = isotonic_layout(title=title) if loaded else isometric_layout()
    times = parameters.get("times") or {}
    low, high = float(times.get("first_s", 1.0)), float(times.get("duration_s", 1000.0))
    label = "length (mm)" if loaded else "force (N)"
    points = Panel(
        f"{_title(label)} against time held (s), one colour per trial",
        "points",
        "points",
        (Channel(POINTS, label),),
        share=1.5,
        x_axis=Axis("time held (s)", _log(low), _log(high), log10=True),
        y_axis=Axis(label, *((50.0, 73.0) if loaded else (0.0, 60.0))),
    )
    right = (STATUS, points, *base.columns[1][2:])
    layout = replace(base, title=title, columns=(base.columns[0], right), points=())
    return layout if times.get("frames", 1) else without_camera(layout)


def dynamic_layout(parameters: Mapping[str, Any]) -> LiveLayout:
    """Curves of a static test, and the gain of the pressure over frequency."""
    loaded = bool(parameters.get("mass_kg"))
    base = without_camera(isotonic_layout() if loaded else isometric_layout())
    sines = parameters.get("sines") or {}
    frequencies = [float(f) for f in sines.get("frequencies_hz") or (0.1, 10.0)]
    points = Panel(
        "Gain of the pressure over its set-point (dB) against frequency (Hz)",
        "points",
        "points",
        (Channel(POINTS, "gain", "dB"),),
        share=1.5,
        x_axis=Axis("frequency (Hz)", _log(min(frequencies)), _log(max(frequencies)), log10=True),
        y_axis=Axis("gain (dB)", -20.0, 3.0),
    )
    right = (STATUS, points, *base.columns[1][2:])
    return replace(
        base, title="Dynamic test", columns=(base.columns[0], right), points=(), window_s=20.0
    )


def fatigue_layout(parameters: Mapping[str, Any]) -> LiveLayout:
    """Curves of a static test, and force range or stroke over the cycles."""
    loaded = bool(parameters.get("mass_kg"))
    base = isotonic_layout() if loaded else without_camera(isometric_layout())
    label = "stroke (mm)" if loaded else "force range (N)"
    points = Panel(
        f"{_title(label)} against cycle",
        "points",
        "points",
        (Channel(POINTS, label),),
        share=1.5,
        x_axis=Axis("cycle", 0.0, _log(float(parameters.get("cycles") or 1000)), log10=True),
        y_axis=Axis(label, 0.0, 20.0 if loaded else 60.0),
    )
    right = (STATUS, points, *base.columns[1][2:])
    return replace(
        base, title="Fatigue test", columns=(base.columns[0], right), points=(), window_s=20.0
    )


def _title(label: str) -> str:
    """A label with a capital letter first; letters of units stay as they are."""
    return label[0].upper() + label[1:]


def _log(value: float) -> float:
    from math import log10

    return log10(max(value, 1e-3))
