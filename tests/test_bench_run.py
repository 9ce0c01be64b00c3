"""An isometric run in process: repeatable, complete, and safe in its end."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import pamrig
from bench_runs import quick, run_bench, run_isometric
from daq.interrupt import StopFlag
from daq.store.run import Run, open_run
from rigs.execution.runner import Watch
from rigs.execution.session import Result
from rigs.protocols.isometric import steps
from rigs.rigfile.config import load_rig
from rigs.steps.steps import Measure, SetLength, SetPressure, Tare, Vent
from rigs.virtual.bench import VirtualBench


@pytest.fixture(scope="module")
def ordinary(tmp_path_factory: pytest.TempPathFactory) -> tuple[Result, Run, VirtualBench]:
    """A short test without anything special, read by several tests and changed by none."""
    return run_bench(tmp_path_factory.mktemp("ordinary"))


def record_of(folder: Path) -> dict[str, bytes]:
    """Contents of everything a run recorded but its manifest and its end (wall clock)."""
    return {
        p.relative_to(folder).as_posix(): p.read_bytes()
        for p in sorted(folder.rglob("*"))
        if p.is_file() and p.name not in ("run.json", "final.json")
    }


def test_the_same_seed_repeats_to_the_bit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """But for the run's name, which stands in every file."""
    monkeypatch.setattr("daq.record.writer.run_name", lambda *_: "20260110T120501Z_a_b_0a1b2c")
    first, second = (run_bench(tmp_path / part, seed=7)[0].folder for part in ("a", "b"))
    a, b = record_of(first), record_of(second)
    assert sorted(a) == sorted(b)
    assert [name for name in a if a[name] != b[name]] == []
    assert any(name.endswith(".mjpg") for name in a)


def test_another_seed_is_another_bench(tmp_path: Path) -> None:
    a = run_bench(tmp_path, seed=7)[1].samples("valve")["counts"]
    b = run_bench(tmp_path, seed=8)[1].samples("valve")["counts"]
    assert not np.array_equal(a[: len(b)], b[: len(a)])


def test_every_point_of_the_schedule_is_there_once(
    ordinary: tuple[Result, Run, VirtualBench],
) -> None:
    result, run, _ = ordinary
    plan = quick(load_rig("virtual"))
    asked = [
        (length, place.replicate, direction, pressure)
        for place, length, points in plan.schedule()
        for direction, pressure in points
    ]
    got = [
        (e["set_length_mm"], e["replicate"], e["direction"], e["set_pressure_kpa"])
        for e in run.events
        if e["kind"] == "point"
    ]
    assert got == asked
    assert result.points == plan.points == len(asked)


def test_no_sample_is_missing(ordinary: tuple[Result, Run, VirtualBench]) -> None:
    _, run, _ = ordinary
    seq = run.samples("valve")["seq"]
    assert np.array_equal(seq, np.arange(seq[0], seq[0] + len(seq)))
    row = run.samples("balance")["row"]
    assert np.array_equal(row, np.arange(row[0], row[0] + len(row)))


def test_the_run_ends_vented_disarmed_and_told(
    ordinary: tuple[Result, Run, VirtualBench],
) -> None:
    _, run, bench = ordinary
    assert run.outcome == "clean"
    vented = [e for e in run.events if e["kind"] == "vented"]
    assert vented
    assert vented[-1]["confirmed"]
    assert bench.board.pressure_kpa < 10.0
    assert not bench.board.controller.safety.armed


def test_run_json_is_written_before_arming(ordinary: tuple[Result, Run, VirtualBench]) -> None:
    _, run, _ = ordinary
    kinds = [e["kind"] for e in run.events]
    assert kinds.index("armed") > 0
    for key in ("parameters", "calibrations", "devices", "rig", "software"):
        assert run.manifest[key]
    assert run.manifest["rig"]["crc32"] == load_rig("virtual").crc32


def test_a_stop_in_mid_run_keeps_what_was_measured(tmp_path: Path) -> None:
    config = load_rig("virtual")
    stop = StopFlag()
    seen: list[Measure] = []

    def point(step: Measure, *_: float) -> None:
        seen.append(step)
        if len(seen) == 3:
            stop.set("SIGINT")

    result = run_isometric(config, quick(config), tmp_path, stop=stop, watch=Watch(point=point))
    run = open_run(result.folder)
    assert run.outcome == result.outcome == "stopped"
    assert len(run.table) == 3
    assert [e for e in run.events if e["kind"] == "vented"][-1]["confirmed"]
    assert (result.folder / "derived" / "report.html").is_file()


def test_over_pressure_ends_the_run_faulted_and_vented(tmp_path: Path) -> None:
    """The supply's regulator fails: the firmware trips on raw counts, the host tells it."""
    config = load_rig("virtual")
    benches = []

    def surge(step: Measure, *_: float) -> None:
        del step
        board = benches[0].rig.bench.board
        board.sensor_override = 4000

    result = run_isometric(
        config, quick(config), tmp_path, watch=Watch(point=surge),
        on_start=lambda runner, _: benches.append(runner), derive=False,
    )  # fmt: skip
    run = open_run(result.folder)
    assert run.outcome == "faulted"
    assert "over_pressure" in str(result.error)
    assert any(e["kind"] == "fault" and "over_pressure" in e["text"] for e in run.events)


def test_a_controller_that_restarts_ends_the_run(tmp_path: Path) -> None:
    config = load_rig("virtual")
    benches = []
    result = run_isometric(
        config, quick(config), tmp_path,
        watch=Watch(point=lambda *_: benches[0].rig.bench.board.reset("brownout")),
        on_start=lambda runner, _: benches.append(runner), derive=False,
    )  # fmt: skip
    assert result.outcome == "faulted"
    assert "restarted" in str(result.error)


def test_a_frozen_controller_ends_the_run(tmp_path: Path) -> None:
    config = load_rig("virtual")
    benches = []
    result = run_isometric(
        config, quick(config), tmp_path,
        watch=Watch(point=lambda *_: benches[0].rig.bench.board.freeze()),
        on_start=lambda runner, _: benches.append(runner), derive=False,
    )  # fmt: skip
    assert result.outcome == "faulted"
    assert result.error is not None
    assert "valve controller" in str(result.error)


def test_random_order_visits_every_point_singly(tmp_path: Path) -> None:
    _, run, _ = run_bench(tmp_path, order="random")
    points = [e for e in run.events if e["kind"] == "point"]
    assert {e["direction"] for e in points} == {"single"}
    pressures = [e["set_pressure_kpa"] for e in points if e["trial"] == 1]
    assert sorted(pressures) == [100.0, 250.0, 450.0, 600.0]


def test_the_method_reads_as_a_method() -> None:
    """Taring happens vented and slack; every trial begins and ends with the vented zero."""
    plan = quick(load_rig("virtual"))
    last_length, vented = None, True
    for step in steps(plan):
        if isinstance(step, SetLength):
            last_length = step.length_mm
        elif isinstance(step, Vent):
            vented = True
        elif isinstance(step, SetPressure):
            vented = False
        elif isinstance(step, Tare):
            assert vented
            assert last_length == plan.slack_length_mm


def test_a_notebook_sees_frames_with_units(tmp_path: Path) -> None:
    result, _, _ = run_bench(
        tmp_path, lengths_mm=(60.0,), pressures_kpa=(200.0, 400.0), derive=True
    )
    run = pamrig.open_run(result.folder)
    assert {"pressure_kpa", "length_mm", "force_n", "temperature_c", "u_force_n"} <= set(run.table)
    assert len(run.table) == 4
    assert {"time_s", "pressure_kpa", "setpoint_kpa"} <= set(run.samples)
    assert run.samples["time_s"].is_monotonic_increasing
    assert "point" in set(run.events["kind"])


@pytest.mark.parametrize(
    ("effect", "expected"),
    [
        ("[effects.liner_threshold]\nthreshold_kpa = 100\n", "less force at the same pressure"),
        ("[effects.braid_friction]\nfriction_n = 2.0\n", "up and down differ"),
    ],
)
def test_effects_of_the_rig_file_show_in_the_table(
    tmp_path: Path, effect: str, expected: str
) -> None:
    text = load_rig("virtual").text.replace(
        "draw_calibration_errors = true", "draw_calibration_errors = false"
    )
    rig = tmp_path / "rig.toml"
    rig.write_text(text + "\n" + effect)
    _, plain, _ = run_bench(tmp_path / "a", derive=True)
    _, run, _ = run_bench(tmp_path / "b", str(rig), derive=True)
    table, base = run.table, plain.table
    if "less force" in expected:
        at = table["set_pressure_kpa"] == 450
        assert (table[at]["force_n"] < base[at]["force_n"] - 2.0).all()
    else:
        at = (table["set_pressure_kpa"] == 250) & (table["set_length_mm"] == 65)
        down = table[at & (table["direction"] == "down")]["force_n"].mean()
        up = table[at & (table["direction"] == "up")]["force_n"].mean()
        assert down - up > 2.0


def test_json_of_the_record_has_no_nan(ordinary: tuple[Result, Run, VirtualBench]) -> None:
    result, _, _ = ordinary
    for line in (result.folder / "events.jsonl").read_text().splitlines():
        json.loads(line, parse_constant=lambda word: pytest.fail(word))


def test_received_bytes_can_be_recorded_and_replayed(tmp_path: Path) -> None:
    """What the wire brought gives the same samples again, through framer and codec."""
    from daq.link.framer import CobsFramer
    from daq.link.telemetry import TelemetryStream
    from valvefw import wire

    config = load_rig("virtual")
    result = run_isometric(config, quick(config), tmp_path, wire=True, derive=False)
    run = open_run(result.folder)
    counts: list[np.ndarray] = []
    framer, stream = CobsFramer(), TelemetryStream(lambda batch: counts.append(batch["counts"]))
    for chunk in run.wire("valve"):
        for payload in framer.feed(chunk.data):
            if payload[0] == wire.TELEMETRY:
                stream.feed(payload, chunk.host_ns)
    stream.flush()
    again = np.concatenate(counts)
    recorded = run.samples("valve")["counts"]
    assert framer.damaged == 0
    n = len(again)  # recording of bytes begins a moment after the first samples came
    assert n > 0.95 * len(recorded)
    assert np.array_equal(again, recorded[-n:])
