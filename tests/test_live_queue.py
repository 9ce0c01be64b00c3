"""The parts of the live view that need no viewer: queue, thinning, chart, layout."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from analysis.layouts.layouts import CAMERA, FORCE, LOG, POINTS, STATE, isometric_layout
from daq.live.chart import HEIGHT, LABEL_GAP, WIDTH, Chart, nice_ticks
from daq.live.decimate import Thinner, decimate
from daq.live.layout import Axis, Panel
from daq.live.queue import DropQueue


def test_full_queue_drops_the_oldest_bulk_and_counts_it():
    queue = DropQueue(bulk_bytes=100)
    for k in range(10):
        queue.put_bulk(30, ("series", k))
    bulk, _, _ = queue.drain()
    assert [item[1] for item in bulk] == [7, 8, 9]
    assert queue.dropped == 7
    assert queue.held_bytes == 0


def test_a_flood_of_samples_does_not_push_out_reduced_points():
    queue = DropQueue(bulk_items=10)
    queue.put_event(("points", "a"))
    for _ in range(1_000):
        queue.put_bulk(1, ("series",))
    bulk, _, facts = queue.drain()
    assert facts == [("points", "a")]
    assert len(bulk) == 10


def test_an_item_larger_than_the_whole_queue_is_dropped_not_kept():
    queue = DropQueue(bulk_bytes=100)
    queue.put_bulk(50, ("small",))
    queue.put_bulk(1_000, ("huge",))
    assert queue.drain() == ([], [], [])
    assert queue.dropped == 2


def test_of_several_pictures_only_the_newest_waits_and_curves_are_not_pushed_out():
    queue = DropQueue(picture_paths=2)
    queue.put_bulk(8, ("curve",))
    for k in range(100):
        queue.put_picture("camera", ("camera", k))
    queue.put_picture("b", ("b", 0))
    queue.put_picture("c", ("c", 0))
    assert queue.drain() == ([("curve",)], [("b", 0), ("c", 0)], [])
    assert (queue.replaced, queue.dropped) == (99, 1)


@given(st.lists(st.integers(0, 400), max_size=60), st.integers(1, 500), st.integers(1, 10))
def test_every_item_is_either_held_or_counted_as_dropped(sizes, limit, items):
    queue = DropQueue(bulk_bytes=limit, bulk_items=items)
    for size in sizes:
        queue.put_bulk(size, (size,))
        assert queue.held_bytes <= limit
    bulk, _, _ = queue.drain()
    assert len(bulk) + queue.dropped == len(sizes)
    assert len(bulk) <= items


def test_a_spike_of_one_sample_survives_the_thinning():
    t = np.arange(1_000) * 1e-3
    v = np.zeros(1_000)
    v[537] = 80.0
    thin_t, thin_v = decimate(t, v, 0.02)
    assert len(thin_t) <= 100
    assert thin_v.max() == 80.0
    assert thin_t[thin_v.argmax()] == t[537]


@settings(deadline=None)
@given(
    st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=300),
    st.sampled_from([0.004, 0.02, 0.5]),
)
def test_thinning_keeps_each_bins_extremes_in_order_of_time(values, bin_s):
    t = np.arange(len(values)) * 1e-3
    v = np.array(values)
    thin_t, thin_v = decimate(t, v, bin_s)
    assert np.all(np.diff(thin_t) > 0)
    bins = np.floor(t / bin_s + 1e-9).astype(int)
    thin_bins = np.floor(thin_t / bin_s + 1e-9).astype(int)
    for b in np.unique(bins):  # oracle: the plain definition, bin by bin
        got = thin_v[thin_bins == b]
        assert len(got) <= max(2, 1)
        assert got.min() == v[bins == b].min()
        assert got.max() == v[bins == b].max()


@settings(deadline=None)
@given(st.lists(st.integers(1, 70), min_size=1, max_size=20), st.sampled_from(["minmax", "mean"]))
def test_thinning_does_not_depend_on_how_samples_were_batched(batches, reduce):
    n = sum(batches)
    t = np.arange(n) * 1e-3
    v = np.sin(np.arange(n) * 0.37) * 10
    thinner = Thinner(0.02, reduce)
    parts, start = [], 0
    for size in batches:
        parts.append(thinner.feed(t[start : start + size], v[start : start + size]))
        start += size
    parts.append(thinner.flush())
    together = decimate(t, v, 0.02, reduce)
    assert np.array_equal(np.concatenate([p[0] for p in parts]), together[0])
    assert np.array_equal(np.concatenate([p[1] for p in parts]), together[1])


def test_samples_that_are_not_numbers_are_left_out_and_disorder_is_sorted():
    t, v = decimate(np.arange(4.0), np.array([1.0, np.nan, np.inf, 4.0]), 0.1)
    assert v.tolist() == [1.0, 4.0]
    thinner = Thinner(0.5)
    t, _ = thinner.feed(np.array([3.0, 1.0, 2.0, 9.0]), np.zeros(4))
    assert t.tolist() == [1.0, 2.0, 3.0]


@example(low=629066.9542143787, span=1e-06)
@given(st.floats(-1e6, 1e6), st.floats(1e-6, 1e6))
def test_ticks_are_round_and_cover_the_range(low, span):
    ticks = nice_ticks(low, low + span)
    step = ticks[1] - ticks[0]
    slack = 1e-6 * (abs(low) + span)
    assert ticks[0] <= low + slack
    assert ticks[-1] >= low + span - slack
    assert 2 <= len(ticks) <= 16
    power = 10.0 ** np.floor(np.log10(step) + 1e-9)
    rounded = 2 * np.spacing(np.abs(ticks).max()) / power  # of the difference of two ticks
    assert min(abs(step / power - m) for m in (1, 2, 5, 10)) < 1e-3 + rounded


def test_chart_axes_grow_with_the_points_and_labels_do_not_overlap():
    chart = Chart(Axis("pressure (kPa)", 0, 500), Axis("force (N)", 0, 50))
    assert not chart.add("a", np.array([500.0]), np.array([50.0]))
    assert not chart.add("b", np.array([500.0]), np.array([50.5]))  # hardly outside
    assert chart.add("c", np.array([500.0]), np.array([120.0]))
    corner = chart.place(np.array([0.0]), np.array([0.0]))[0]
    assert corner.tolist() == [0.0, HEIGHT]
    _, at = chart.label_positions()
    assert np.all(np.diff(at[:, 1]) >= LABEL_GAP - 1e-9)
    inside = chart.place(np.array([500.0, 500.0]), np.array([50.0, 120.0]))
    assert np.all((inside >= 0) & (inside <= [WIDTH, HEIGHT]))


def test_chart_line_runs_through_means_of_repeats():
    chart = Chart(Axis("x", 0, 100), Axis("y", 0, 10))
    chart.add("a", np.array([50.0, 10.0, 50.4, 10.2]), np.array([5.0, 1.0, 7.0, 3.0]))
    line = chart.line("a")
    expected = chart.place(np.array([10.1, 50.2]), np.array([2.0, 6.0]))
    assert np.allclose(line, expected)


def test_isometric_layout_has_a_panel_for_every_path_a_run_uses():
    layout = isometric_layout()
    paths = [*layout.channels, CAMERA, LOG, POINTS, STATE]
    paths += [f.path for f in (*layout.feeds, *layout.event_feeds, *layout.points)]
    for path in paths:
        assert layout.panel_of(path) is not None, path
    assert layout.panel_of(FORCE).title == "Force (N)"
    assert layout.panel_of("force/predicted_n").title == "Force (N)"
    assert layout.panel_of("forces/x") is None


def test_every_panel_with_a_quantity_names_its_unit():
    units = {"pressure": "(kPa)", "force": "(N)", "length": "(mm)", "valves": "(%)"}
    titles = {p.origin: p.title for p in isometric_layout().panels}
    for origin, unit in units.items():
        assert unit in titles[origin]


def test_impossible_panels_are_refused():
    with pytest.raises(ValueError, match="kind 'graph'"):
        Panel("x", "graph", "x")
    with pytest.raises(ValueError, match="needs x_axis"):
        Panel("x", "points", "x")


def test_importing_the_live_view_does_not_import_the_viewer():
    code = (
        "import sys, daq.live.live, daq.live.layout, daq.live.viewfile, analysis.layouts.layouts\n"
        "print([m for m in ('rerun', 'cv2', 'pyarrow', 'pandas') if m in sys.modules])"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"
