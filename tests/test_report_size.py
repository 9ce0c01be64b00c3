"""The report of a ram test: every switching that a reader could see, in a file of usual size."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from analysis.figures.timeline import ENVELOPE_BINS, on_spans
from analysis.reduction.points import Reduction
from analysis.reporting.report import write_report
from protocol_runs import run_short
from rigs.protocols.registry import procedure


def drawn(seconds: np.ndarray, spans: list[tuple[float, float]]) -> np.ndarray:
    """Whether each sample lies in a span."""
    begin = np.array([a for a, _ in spans])
    end = np.array([a + w for a, w in spans])
    middle = seconds + 0.5e-3
    return ((middle[:, None] > begin) & (middle[:, None] < end)).any(axis=1)


def test_spans_are_exact_to_the_sample() -> None:
    rng = np.random.default_rng(1)
    on = np.repeat(rng.random(200) < 0.4, rng.integers(1, 30, 200))
    seconds = np.arange(len(on)) * 1e-3
    assert np.array_equal(drawn(seconds, on_spans(seconds, on)), on)
    assert on_spans(seconds[:0], on[:0]) == []
    assert on_spans(np.array([2.0]), np.array([True])) == [(2.0, 0.0)]


def test_a_signal_that_switches_too_often_to_show_becomes_its_envelope() -> None:
    on = np.arange(20_000) % 4 == 0
    on[8000:12_000] = False
    on[10_000] = True  # alone in a long pause
    seconds = np.arange(len(on)) * 1e-3
    spans = on_spans(seconds, on)
    shown = drawn(seconds, spans)
    assert len(spans) <= ENVELOPE_BINS
    assert shown[on].all()
    assert shown[8000:12_000].sum() == 1


def test_the_report_of_a_ram_test_is_of_usual_size(tmp_path: Path) -> None:
    """It was 2.0 MB for this test and 7.5 MB for the full one: a polygon through every sample."""
    _, run, _ = run_short("ram", tmp_path, moves=("up to A", "down to A"), repeats=1)
    reduction: Reduction = procedure("ram").analysis.reduce(run)
    page = tmp_path / "report.html"
    write_report(run, page, reduction)
    assert page.stat().st_size < 400_000
    (figure,) = [
        s.figure for s in procedure("ram").analysis.findings(run, reduction).sections if s.figure
    ]
    lanes = figure().axes[1]  # type: ignore[union-attr]
    assert [text.get_text() for text in lanes.get_yticklabels()] == [
        "switch A", "switch B", "inlet", "outlet",
    ]  # fmt: skip
    samples = run.samples("valve")
    inlet = len([p for p in lanes.collections[2].get_paths() if len(p.vertices)])
    starts = np.count_nonzero(np.diff((samples["inlet_u5"] > 0).astype(int)) > 0)
    assert inlet == pytest.approx(starts, abs=2)
