"""The view file of a recorded run: everything in it, from finished and interrupted runs."""

from __future__ import annotations

import os
import urllib.request
import warnings

import cv2
import numpy as np
import pytest

from analysis.layouts import layouts as names
from analysis.layouts.layouts import isometric_layout, measured_edges
from daq.calibration import Calibration
from daq.clock import VirtualClock
from daq.link.telemetry import VALVE_COLUMNS, VALVE_UNITS
from daq.live.viewfile import build_view, open_view, plain_layout, view_maker
from daq.record.writer import RecordWriter
from daq.store.derive import derive
from daq.store.run import open_run

N = 4_000
BALANCE = {"row": "int64", "host_ns": "int64", "grams": "float64", "stable": "uint8"}


def calibration(quantity: str, unit: str, raw_unit: str, offset: float, scale: float):
    return Calibration(
        quantity, unit, raw_unit, offset, scale, 0.1, 0.001, (0.0, 4095.0), "c1", "2026-01-01", ""
    )


def small_run(root, finish: bool = True):
    """4 s at 1 kHz with two points, three frames and a fault."""
    clock = VirtualClock(5_000_000_000)
    cals = [
        calibration("pressure_kpa", "kPa", "counts", -10.0, 0.25),
        calibration("force_n", "N", "g", 0.0, -0.0098),
        calibration("length_mm", "mm", "pixel", 40.0, 0.11),
    ]
    manifest = {
        "protocol": "isometric",
        "specimen": "s",
        "calibrations": {c.quantity: c.to_dict() for c in cals},
    }
    writer = RecordWriter(root, manifest, clock, durable=False, threaded=False)
    start = writer.start_ns
    writer.stream("valve", VALVE_COLUMNS, VALVE_UNITS)
    writer.stream("balance", BALANCE, {"grams": "g"})
    seq = np.arange(N)
    counts = 400 + (seq // 1000) * 100
    columns = {
        "seq": seq,
        "device_us": 77_000 + seq * 1000,
        "host_ns": start + seq * 1_000_000,
        "boot": np.full(N, 9),
        "counts": counts,
        "flags": np.zeros(N),
        "inlet_u5": np.where(seq < 200, 200, 0),
        "vent_u5": np.zeros(N),
        "setpoint_x16": counts * 16,
    }
    for part in np.array_split(seq, 80):
        writer.append("valve", {k: columns[k][part].astype(d) for k, d in VALVE_COLUMNS.items()})
    rows = np.arange(40)
    writer.append(
        "balance",
        {
            "row": rows,
            "host_ns": start + rows * 100_000_000,
            "grams": -100.0 * rows,
            "stable": np.ones(40, dtype=np.uint8),
        },
    )
    gray = np.full((480, 640), 190, np.uint8)
    gray[150:330, 100:200] = 35
    gray[150:330, 400:470] = 35
    jpeg = cv2.imencode(".jpg", gray)[1].tobytes()
    writer.event("command", device="stage", length_mm=60.0)
    for k in range(3):
        number = writer.frame(jpeg, start + k * 1_000_000_000, seq=k)
        writer.event("length", frame=number, pixels=200.0 + k, u_pixels=0.1, trusted=k < 2)
    for k, state in enumerate(("settle", "point")):
        clock.sleep(1.0)
        writer.event("state", state=state)
        writer.event(
            "point", set_length_mm=60.0, valve_seq=[k * 1000, k * 1000 + 500],
            balance_rows=[k * 10, k * 10 + 5],
        )  # fmt: skip
    writer.event("fault", device="valve", text="fault over_pressure")
    if finish:
        writer.finalize("faulted")
    else:
        writer.abandon()
    return open_run(writer.folder)


def contents(path) -> tuple[dict[str, np.ndarray], dict[str, list]]:
    """What the file holds, read back by the viewer's own reader: curves, and everything else."""
    import rerun.chunk

    curves: dict[str, list] = {}
    others: dict[str, list] = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for chunk in rerun.chunk.RrdReader(str(path)).stream():
            batch = chunk.to_record_batch()
            entity = str(chunk.entity_path).strip("/")
            for name in batch.schema.names:
                values = batch.column(name).to_pylist()
                if name.endswith("Scalars:scalars"):
                    at = batch.column("time").to_numpy(zero_copy_only=False)
                    curves.setdefault(entity, []).append(
                        (at.astype("timedelta64[ns]").astype(np.int64) * 1e-9, values)
                    )
                else:
                    others.setdefault(f"{entity}:{name.split(':')[-1]}", []).extend(values)
    joined = {}
    for entity, parts in curves.items():
        t = np.concatenate([p[0] for p in parts])
        v = np.array([value[0] for p in parts for value in p[1]])
        order = np.argsort(t, kind="stable")
        joined[entity] = np.column_stack((t[order], v[order]))
    return joined, others


@pytest.fixture(scope="module")
def view(tmp_path_factory):
    root = tmp_path_factory.mktemp("runs")
    run = small_run(root)
    path = build_view(run, root / "view.rrd", isometric_layout(), measured_edges(run))
    return contents(path)


def test_every_series_is_there_sample_by_sample_in_engineering_units(view):
    curves, _ = view
    pressure = curves[names.PRESSURE]
    assert len(pressure) == N
    expected = -10.0 + 0.25 * (400 + (np.arange(N) // 1000) * 100)
    assert np.allclose(pressure[:, 1], expected)
    assert np.allclose(pressure[:, 0], np.arange(N) * 1e-3)
    assert len(curves[names.INLET]) == N
    assert curves[names.INLET][:, 1].max() == 100.0
    assert np.allclose(curves[names.FORCE][:, 1], 0.98 * np.arange(40))


def test_a_staircase_keeps_its_steps_only(view):
    curves, _ = view
    assert curves[names.SET_POINT][:, 1].tolist() == [90.0, 115.0, 140.0, 165.0, 165.0]
    assert np.allclose(curves[names.SET_POINT][:, 0], [0.0, 1.0, 2.0, 3.0, 3.999])
    assert np.allclose(curves[names.SET_LENGTH], [[0.0, 60.0], [3.999, 60.0]])


def test_lengths_come_from_trusted_frames_at_the_time_of_the_frame(view):
    curves, _ = view
    assert np.allclose(curves[names.LENGTH], [[0.0, 62.0], [1.0, 62.11]])


def test_states_points_frames_edges_and_messages_are_there(view):
    _, others = view
    assert [s[0] for s in others[f"{names.STATE}:state"] if s] == ["settle", "point"]
    assert any("over_pressure" in s[0] for s in others[f"{names.FAULT}:state"] if s)
    sizes = [len(p) for p in others["points/curves/60\\ mm/points:positions"] if p]
    assert sizes == [1, 2]
    assert len([b for b in others["camera/frame:blob"] if b]) == 3
    strips = [s for s in others["camera/edges:strips"] if s]
    assert len(strips) == 3
    ends = sorted(point[0] for point in (strips[0][0][0], strips[0][1][0]))
    assert ends == pytest.approx([200.0, 400.0], abs=0.5)
    texts = [t[0] for t in others["log:text"] if t]
    assert any("over_pressure" in t for t in texts)
    assert texts[-1].endswith("outcome: faulted")


def test_an_interrupted_run_gives_a_view_of_what_is_sound(tmp_path):
    run = small_run(tmp_path, finish=False)
    segment = next((run.folder / "samples" / "valve").glob("*.arrows"))
    with segment.open("r+b") as file:  # the tail that a kill tears
        file.truncate(segment.stat().st_size - 33)
    run = open_run(run.folder)
    curves, others = contents(build_view(run, tmp_path / "v.rrd", isometric_layout()))
    assert len(curves[names.PRESSURE]) == N - 50
    texts = [t[0] for t in others["log:text"] if t]
    assert texts[-1].endswith("outcome: interrupted")
    assert any("record:" in t for t in texts)


def test_a_long_series_is_thinned_and_keeps_its_extremes(tmp_path):
    run = small_run(tmp_path)
    path = build_view(run, tmp_path / "v.rrd", isometric_layout(), most_rows=100)
    curves, _ = contents(path)
    assert len(curves[names.PRESSURE]) <= 102
    assert curves[names.PRESSURE][:, 1].max() == 165.0


def test_a_run_nobody_described_still_shows_every_column(tmp_path):
    run = small_run(tmp_path)
    curves, _ = contents(build_view(run, tmp_path / "v.rrd"))
    assert set(curves) >= {"valve/pressure_kpa", "valve/flags", "balance/force_n"}
    assert {p.origin for p in plain_layout(run).panels} >= {"valve", "balance", "state"}


def test_rebuilding_makes_the_view_with_the_other_derived_files(tmp_path):
    run = small_run(tmp_path)
    derive(run, [view_maker(isometric_layout())])
    assert run.derived("view.rrd").is_file()
    first, _ = contents(run.derived("view.rrd"))
    derive(run, [view_maker(isometric_layout())])
    second, _ = contents(open_run(run.folder).derived("view.rrd"))
    assert first.keys() == second.keys()
    assert all(np.array_equal(first[k], second[k]) for k in first)


def test_opening_an_interrupted_run_leaves_its_folder_as_it_was(tmp_path):
    run = small_run(tmp_path, finish=False)
    before = sorted(p.relative_to(tmp_path) for p in tmp_path.rglob("*"))
    with_page = open_view(run, isometric_layout(), port=0)
    try:
        assert with_page.url in with_page.message
        with urllib.request.urlopen(with_page.url, timeout=60.0) as page:
            assert page.status == 200
        with urllib.request.urlopen(with_page.url + "view.rrd", timeout=60.0) as data:
            (tmp_path / "got.rrd").write_bytes(data.read())
        made = with_page._temporary.name
    finally:
        with_page.close()
    with pytest.raises(OSError, match="refused"):
        urllib.request.urlopen(with_page.url, timeout=60.0)
    curves, _ = contents(tmp_path / "got.rrd")
    assert "pressure/measured_kpa" in curves
    (tmp_path / "got.rrd").unlink()
    assert sorted(p.relative_to(tmp_path) for p in tmp_path.rglob("*")) == before
    assert not os.path.exists(made)
