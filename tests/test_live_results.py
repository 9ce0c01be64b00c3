"""The results of the valve tests stand in the stored view as the live view showed them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from analysis.layouts.layouts import POINTS
from analysis.registry import analysis_of
from analysis.reporting.report import report_json
from daq.live.layout import LiveLayout
from daq.live.scene import Scene
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


def drawn_live(shown: Shown, layout: LiveLayout, path: Path) -> Curves:
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
    return curves_of(contents(path)[1])


@pytest.mark.parametrize("name", TESTS)
def test_the_stored_view_has_the_points_of_the_live_view(name: str, tmp_path: Path) -> None:
    shown: Shown = []

    def listen(runner: Any) -> None:
        runner.watch.result = lambda x, y, label: shown.append((x, y, label))

    _, run, _ = run_short(name, tmp_path, begin=listen, **TESTS[name])
    layout = analysis_of(name).layout(run.manifest["parameters"])
    live = drawn_live(shown, layout, tmp_path / "live.rrd")
    stored = curves_of(contents(build_view(run, tmp_path / "view.rrd", layout))[1])
    assert shown
    assert [f for f in report_json(run)["faults"] if f["kind"] == "result"] == []
    assert {str(label) for _, _, label in shown} == {k.replace("\\", "") for k in live}
    assert stored.keys() == live.keys()
    for label, positions in live.items():
        assert np.array_equal(stored[label], positions)
