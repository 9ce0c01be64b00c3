"""The results of the valve tests stand in the stored view as the live view showed them."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from analysis.layouts.layouts import POINTS, SET_LENGTH, isometric_layout
from analysis.registry import analysis_of
from analysis.reporting.report import report_json
from daq.live.blueprint import blueprint
from daq.live.layout import Axis, LiveLayout
from daq.live.scene import Scene, label_places
from daq.live.viewfile import build_view
from protocol_runs import run_short
from test_live_viewfile import contents

Shown = list[tuple[float, float, str]]
Curves = dict[str, list[list[float]]]

TESTS: dict[str, dict[str, Any]] = {
    "switching-time": {"pressures_kpa": (200.0,), "repeats": 1},
    "switching-voltage": {"pressures_kpa": (200.0,), "step_v": 0.4},
    "flow": {"pressures_kpa": (200.0,), "repeats": 1},
    "step": {"schemes": ("two", "slide"), "pressures_kpa": (100.0, 200.0), "step_s": 0.6},
    "ram": {"moves": ("up to A", "down to A"), "repeats": 1, "hold_s": 0.2},
}


def curves_of(others: dict[str, list[Any]]) -> Curves:
    """The last drawing of every curve of the points panel: label to positions."""
    drawn: Curves = {}
    for name, values in others.items():
        if name.startswith("points/curves/") and name.endswith("/points:positions"):
            rows = [v for v in values if v]
            drawn[name.split("/")[2]] = max(rows, key=len)
    return drawn


def drawn_live(shown: Shown, layout: LiveLayout, path: Path) -> dict[str, list[Any]]:
    """What the live view's own drawing makes of the results that a run handed to it."""
    import rerun as rr

    rec = rr.RecordingStream("pamrig", recording_id="live")
    rec.save(path)
    scene = Scene(rec, layout)
    scene.start()
    for k, (x, y, label) in enumerate(shown):
        scene.points(POINTS, float(k), label, np.array([x]), np.array([y]))
    rec.flush(timeout_sec=60.0)
    rec.disconnect()
    return contents(path)[1]


@pytest.mark.parametrize("name", TESTS)
def test_the_stored_view_has_the_points_of_the_live_view(name: str, tmp_path: Path) -> None:
    shown: Shown = []

    def listen(runner: Any) -> None:
        runner.watch.result = lambda x, y, label: shown.append((x, y, label))

    _, run, _ = run_short(name, tmp_path, begin=listen, **TESTS[name])
    layout = analysis_of(name).layout(run.manifest["parameters"])
    live = curves_of(drawn_live(shown, layout, tmp_path / "live.rrd"))
    stored = curves_of(contents(build_view(run, tmp_path / "view.rrd", layout))[1])
    assert shown
    assert [f for f in report_json(run)["faults"] if f["kind"] == "result"] == []
    assert {str(label) for _, _, label in shown} == {k.replace("\\", "") for k in live}
    assert stored.keys() == live.keys()
    for label, positions in live.items():
        assert np.array_equal(stored[label], positions)


@pytest.mark.parametrize("alone", [[150.0, 450.0], []])
def test_an_axis_of_a_joint_has_a_width_where_no_difference_is_set(alone: list[float]) -> None:
    """One muscle alone: `difference_kpa = [0]` made an axis from 0 to 0, and no view or report."""
    parameters = {"difference_kpa": [0.0], "alone_kpa": alone, "instruments": {"torque": "gauge"}}
    layout = analysis_of("joint-static").layout(parameters)
    charts = [p for p in layout.panels if p.kind == "points"]
    assert charts
    for panel in charts:
        assert panel.x_axis is not None
        assert panel.x_axis.high == max(alone, default=100.0)
        assert float(panel.x_axis.text(150.0)) == 150.0


def test_a_curve_for_comparison_is_drawn_but_is_no_result(tmp_path: Path) -> None:
    """What the thesis measured, or a model says, is not in the table of this test's results."""
    layout = analysis_of("flow").layout({"result_axis": ["air velocity (m/s)", 80.0]})
    shown = [(200.0, 31.3, "measured"), (200.0, 30.2, "valve of the thesis")]
    drawn = drawn_live(shown, layout, tmp_path / "live.rrd")
    assert len(curves_of(drawn)) == 2
    (table,) = drawn["results/newest:text"][-1]
    assert "| 1 | measured | 200.0 | 31.30 |" in table
    assert "thesis" not in table


@pytest.mark.parametrize(
    ("axis", "value", "shown"),
    [
        (Axis("pressure (kPa)", 0.0, 600.0), 549.9632, "550.0"),
        (Axis("force (N)", 0.0, 100.0), 98.2371, "98.24"),
        (Axis("gain (dB)", -20.0, 3.0), -0.69471, "−0.695"),
        (Axis("frequency (Hz)", -1.0, 1.0, log10=True), math.log10(0.5), "0.500"),
        (Axis("time held (s)", 0.0, 2.0, log10=True), math.log10(5.6617), "5.66"),
        (Axis("cycle", 0.0, 5.0, log10=True), math.log10(43_152.0), "43152"),
    ],
)
def test_results_have_the_digits_that_their_axis_can_show(
    axis: Axis, value: float, shown: str
) -> None:
    assert axis.text(value) == shown


def test_names_of_edges_near_each_other_do_not_overlap() -> None:
    """A muscle of 50 mm: its edges are closer than "right edge" is wide."""
    edges = [((500.0, 40.0), (501.0, 400.0), "left edge"), ((540.0, 40.0), (541.0, 400.0), "right")]
    gap = ((501.0, 220.0), (540.0, 220.0), "39.00 px = 50.310 mm")
    places = label_places([*edges, gap])
    heights = sorted(y for _, y in places)
    assert np.diff(heights).min() > 50.0


@pytest.mark.parametrize(
    ("ends", "first", "last"),
    [({}, -81.0, 0.0), ({"whole_s": 100.0}, -35.0, 100.0), ({"until_s": 60.0}, -21.0, 60.0)],
)
def test_the_legend_of_a_curve_has_room_before_the_oldest_data(
    ends: dict[str, float], first: float, last: float
) -> None:
    made = blueprint(isometric_layout(), extra=False, **ends)
    views = [view for column in made.root_container.contents for view in column.contents]
    curves = [view for view in views if type(view).__name__ == "TimeSeriesView"]
    assert len(curves) == 4
    for view in [*curves, next(v for v in views if type(v).__name__ == "StateTimelineView")]:
        axis = view.properties["TimeAxis"]
        (shown,) = axis.view_range.as_arrow_array().to_pylist()
        assert (shown["start"], shown["end"]) == (first * 1e9, last * 1e9)


def test_a_length_that_nothing_sets_is_not_shown_as_set() -> None:
    layouts = [analysis_of(name).layout({}) for name in ("isotonic", "creep", "free-contraction")]
    assert not any(SET_LENGTH in layout.channels for layout in layouts)
    assert SET_LENGTH in analysis_of("isometric").layout({}).channels


def test_the_time_axis_of_a_live_test_grows_and_then_moves(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The first seconds of a test would be a line at the right edge of a whole minute."""
    import rerun as rr

    sent: list[float | None] = []

    def note(layout: LiveLayout, *, until_s: float | None = None, **more: Any) -> Any:
        sent.append(until_s)
        return blueprint(layout, until_s=until_s, **more)

    monkeypatch.setattr("daq.live.scene.blueprint", note)
    for live, expected in ((True, [15.0, 60.0, None]), (False, [None])):
        sent.clear()
        rec = rr.RecordingStream("pamrig", recording_id=f"axis {live}")
        rec.save(tmp_path / f"{live}.rrd")
        scene = Scene(rec, isometric_layout(), live)
        scene.start()
        for time_s in range(0, 100, 5):
            scene.series("pressure/measured_kpa", np.array([float(time_s)]), np.array([1.0]))
        rec.disconnect()
        assert sent == expected
