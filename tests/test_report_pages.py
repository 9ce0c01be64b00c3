"""What was seen on printed pages and is not to come back: words, units, gaps, breaks."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

from analysis.figures.timeline import broken, timeline_figure
from analysis.registry import analysis_of
from analysis.reporting.report import render_report, report_json
from analysis.run_table import reduce_run
from daq.store.run import Run
from protocol_runs import run_short


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Run]:
    root = tmp_path_factory.mktemp("pages")
    return {name: run_short(name, root)[1] for name in ("creep", "fatigue", "hysteresis")}


@pytest.mark.parametrize("name", ["creep", "fatigue", "hysteresis"])
def test_normal_steps_of_a_test_are_no_faults(name: str, runs: dict[str, Run]) -> None:
    made: dict[str, Any] = report_json(runs[name])
    assert made["faults"] == []


def test_what_is_held_is_named_with_its_units(runs: dict[str, Run]) -> None:
    found = analysis_of("creep").findings(runs["creep"], reduce_run(runs["creep"]))
    assert "1.154 kg, 300 kPa" in found.headline
    # Value and uncertainty have as many decimals as each other.
    value, u = re.findall(r"([\d.]+) ± ([\d.]+) mm", found.headline)[0]
    assert len(value.partition(".")[2]) == len(u.partition(".")[2])


def test_no_page_speaks_of_tables_of_the_thesis(runs: dict[str, Run]) -> None:
    assert not re.search(r"Table [A-D]-\d|Figure \d-\d", render_report(runs["hysteresis"]))


def test_what_was_not_recorded_is_a_gap_in_the_time_line(runs: dict[str, Run]) -> None:
    figure = timeline_figure(runs["fatigue"])
    assert figure is not None
    times = figure.axes[0].lines[1].get_xdata()
    assert np.isnan(np.asarray(times, dtype=float)).any()
    x, y = broken(np.r_[0.0:1.0:0.1, 5.0:6.0:0.1], np.arange(20.0))
    assert np.isnan(x[10])
    assert np.isnan(y).sum() == 1
    x, _ = broken(np.arange(0.0, 100.0, 2.0), np.arange(50.0))
    assert not np.isnan(x).any(), "slow readings are no gaps"
