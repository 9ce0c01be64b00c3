"""A record while it is written and as it is read back: whole, torn, killed, disk full."""

from __future__ import annotations

import contextlib
import ctypes
import errno
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import daq.record.disk
from cli.protocols.terminal import record_sentence
from daq.clock import RealClock
from daq.errors import RecordError
from daq.record.sealed import SealError, open_file, open_line, seal_file, seal_line
from daq.record.segments import BatchDecoder, BatchEncoder, StreamSchema
from daq.record.writer import RecordWriter
from daq.store.run import open_run
from daq.store.verify import verify
from daq_records import (
    MANIFEST,
    begin,
    fill,
    jpeg,
    valve_batch,
)

# So that a subprocess finds what stands beside this file.
BESIDE = {**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])}


def same(columns: dict[str, np.ndarray], expected: dict[str, np.ndarray]) -> None:
    assert list(columns) == list(expected)
    for name, values in expected.items():
        assert columns[name].dtype == values.dtype
        np.testing.assert_array_equal(columns[name], values)


# -- a finished run ----------------------------------------------------------


@pytest.mark.parametrize("threaded", [False, True])
def test_all_that_was_written_is_read_back(tmp_path: Path, threaded: bool) -> None:
    writer, clock = begin(tmp_path, threaded=threaded, durable=threaded)
    fill(writer, clock)
    writer.finalize("clean", gaps={"valve": 0})
    run = open_run(writer.folder)
    assert run.outcome == "clean"
    same(run.samples("valve"), valve_batch(0, 600))
    same(run.between("valve", "seq", 70, 80), valve_batch(70, 10))
    assert run.samples("balance")["grams"].tolist() == [-100.25 - k for k in range(12)]
    assert [run.frame_bytes(k) for k in range(12)] == [jpeg(k) for k in range(12)]
    assert run.frames[3] == {"frame": 3, "host_ns": 9_150_000_000, "exposure_us": 1003}
    assert run.events[2] == {
        "n": 2,
        "t_ns": 100_000_000,
        "kind": "state",
        "state": "point",
        "pressure_kpa": 40.0,
        "text": "µ\n",
    }
    assert [c.data for c in run.wire("balance")][5] == b"S S 5 g\r\n"
    assert run.manifest["parameters"] == MANIFEST["parameters"]
    assert run.calibration("pressure_kpa").scale == 0.25
    assert run.final is not None
    assert run.final["rows"] == {"balance": 12, "valve": 600}
    assert run.final["gaps"] == {"valve": 0}
    assert verify(run) == []
    assert run.problems == []


def test_segments_turn_over_and_are_plain_arrow_streams(tmp_path: Path) -> None:
    import pyarrow as pa

    writer, clock = begin(tmp_path)
    fill(writer, clock)
    writer.finalize("clean")
    segments = sorted((writer.folder / "samples" / "valve").iterdir())
    assert [p.name for p in segments] == ["000001.arrows", "000002.arrows", "000003.arrows"]
    tables = [pa.ipc.open_stream(p.read_bytes()).read_all() for p in segments]
    assert [t.num_rows for t in tables] == [200, 200, 200]
    assert pa.concat_tables(tables)["counts"].to_numpy().tolist() == (
        valve_batch(0, 600)["counts"].tolist()
    )
    assert tables[0].schema.field("device_us").metadata == {b"unit": b"us"}


def test_the_same_inputs_give_the_same_bytes_but_for_name_and_wall_clock(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("daq.record.writer.run_name", lambda *_: "20260110T120501Z_a_b_0a1b2c")
    folders = []
    for root in ("first", "second"):
        writer, clock = begin(tmp_path / root)
        fill(writer, clock)
        writer.finalize("clean")
        folders.append(writer.folder)
    names = [sorted(p.relative_to(f) for f in [f] for p in f.rglob("*")) for f in folders]
    assert names[0] == names[1]
    for name in names[0]:
        if (folders[0] / name).is_file() and name.name not in ("run.json", "final.json"):
            assert (folders[0] / name).read_bytes() == (folders[1] / name).read_bytes()


def test_finalize_twice_keeps_the_first_word(tmp_path: Path) -> None:
    writer, clock = begin(tmp_path)
    fill(writer, clock, 2)
    writer.finalize("stopped", why="Ctrl-C")
    before = (writer.folder / "final.json").read_bytes()
    writer.finalize("clean")
    assert (writer.folder / "final.json").read_bytes() == before
    assert open_run(writer.folder).outcome == "stopped"
    with pytest.raises(ValueError, match="clean, stopped, aborted, faulted"):
        writer.finalize("great")


def test_folder_names_say_when_what_and_which(tmp_path: Path) -> None:
    writer, _ = begin(tmp_path)
    writer.finalize("clean")
    stamp, protocol, specimen, tag = writer.run_id.split("_")
    assert (protocol, specimen) == ("isometric", "muscle-7")
    assert len(stamp) == 16
    assert stamp.endswith("Z")
    assert len(tag) == 6
    assert open_run(writer.folder).manifest["run_id"] == writer.run_id


def test_run_json_is_there_before_anything_else(tmp_path: Path) -> None:
    writer, _ = begin(tmp_path)
    run = open_run(writer.folder)
    assert run.manifest["protocol"] == "isometric"
    assert run.manifest["started"]["monotonic_ns"] == 9_000_000_000
    assert run.outcome == "interrupted"
    writer.abandon()


def test_data_are_with_the_operating_system_as_soon_as_append_returns(tmp_path: Path) -> None:
    writer, _ = begin(tmp_path)
    for k in range(3):
        writer.append("valve", valve_batch(50 * k))
        assert len(open_run(writer.folder).samples("valve")["seq"]) == 50 * (k + 1)
    writer.event("state", state="zero")
    assert open_run(writer.folder).events[0]["state"] == "zero"
    writer.abandon()


def test_a_batch_that_does_not_fit_its_stream_is_refused_and_nothing_is_written(
    tmp_path: Path,
) -> None:
    writer, _ = begin(tmp_path)
    good = valve_batch(0)
    for bad in (
        {k: v for k, v in good.items() if k != "counts"},
        {**good, "more": good["seq"]},
        {**good, "counts": good["counts"][:10]},
        {**good, "counts": good["counts"].astype(np.float64)},
    ):
        with pytest.raises(ValueError, match="stream valve"):
            writer.append("valve", bad)
    writer.append("valve", {**good, "seq": good["seq"].astype(np.int32)})  # widening is safe
    writer.finalize("clean")
    run = open_run(writer.folder)
    same(run.samples("valve"), good)
    assert verify(run) == []


def test_reserved_names_and_texts_in_columns_are_refused(tmp_path: Path) -> None:
    writer, _ = begin(tmp_path)
    with pytest.raises(ValueError, match="taken"):
        writer.event("state", crc="x")
    with pytest.raises(ValueError, match="events"):
        writer.stream("notes", {"text": "U10"})
    with pytest.raises(ValueError, match="file name"):
        writer.stream("../up", {"x": "int64"})
    with pytest.raises(ValueError, match="other columns"):
        writer.stream("valve", {"x": "int64"})
    writer.abandon()


def test_not_a_number_becomes_null_in_events_and_numpy_becomes_plain(tmp_path: Path) -> None:
    writer, _ = begin(tmp_path)
    writer.event("point", a=float("nan"), b=np.float64(1.5), c=np.arange(2), d=(1, np.int8(2)))
    writer.abandon()
    event = open_run(writer.folder).events[0]
    assert (event["a"], event["b"], event["c"], event["d"]) == (None, 1.5, [0, 1], [1, 2])


# -- interrupted runs --------------------------------------------------------


def test_an_interrupted_run_opens_and_says_so(tmp_path: Path) -> None:
    writer, clock = begin(tmp_path)
    fill(writer, clock)
    writer.abandon()
    run = open_run(writer.folder)
    assert run.outcome == "interrupted"
    assert run.final is None
    same(run.samples("valve"), valve_batch(0, 600))
    assert verify(run) == []


def test_a_torn_chunk_at_the_end_is_unverified_and_not_read(tmp_path: Path) -> None:
    writer, clock = begin(tmp_path, segment_rows=10_000)
    fill(writer, clock, 4)
    writer.abandon()
    segment = writer.folder / "samples/valve/000001.arrows"
    message, _ = BatchEncoder(open_run(writer.folder).schema("valve")).encode(valve_batch(200))
    with open(segment, "ab") as file:
        file.write(message[:1000])
    run = open_run(writer.folder)
    same(run.samples("valve"), valve_batch(0, 200))
    (problem,) = verify(run)
    assert problem.file == "samples/valve/000001.arrows"
    assert problem.offset == segment.stat().st_size - 1000
    assert problem.tail


def test_a_torn_last_line_is_unverified_and_not_read(tmp_path: Path) -> None:
    writer, clock = begin(tmp_path)
    fill(writer, clock, 4)
    writer.abandon()
    for name in ("events.jsonl", "samples/valve.index.jsonl"):
        path = writer.folder / name
        os.truncate(path, path.stat().st_size - 20)
    run = open_run(writer.folder)
    assert [e["n"] for e in run.events] == [0, 1, 2]
    same(run.samples("valve"), valve_batch(0, 150))
    problems = verify(run)
    assert {p.file for p in problems if p.tail} == {
        "events.jsonl",
        "samples/valve.index.jsonl",
        "samples/valve/000001.arrows",
    }
    cut = [p for p in problems if not p.tail]  # the map of files knows that they were longer
    assert [p.file for p in cut] == ["events.jsonl", "samples/valve.index.jsonl"]
    assert all("bytes, expected" in p.what for p in cut)


def test_one_damaged_chunk_loses_its_rows_only_and_they_are_named(tmp_path: Path) -> None:
    writer, clock = begin(tmp_path, segment_rows=10_000)
    fill(writer, clock)
    writer.finalize("clean")
    segment = writer.folder / "samples/valve/000001.arrows"
    entry = json.loads((writer.folder / "samples/valve.index.jsonl").read_text().splitlines()[5])
    data = bytearray(segment.read_bytes())
    data[entry["offset"] + 700] ^= 4
    segment.write_bytes(data)
    run = open_run(writer.folder)
    assert run.lost_rows("valve") == [(150, 200)]
    seq = run.samples("valve")["seq"]
    assert seq.tolist() == [*range(150), *range(200, 600)]
    same(run.between("valve", "seq", 200, 250), valve_batch(200))
    assert any("rows 150 to 199 are lost" in p.what for p in verify(run))


def test_a_damaged_schema_message_or_first_line_costs_no_rows(tmp_path: Path) -> None:
    for name, place in (("samples/valve/000001.arrows", 40), ("samples/valve.index.jsonl", 40)):
        writer, clock = begin(tmp_path)
        fill(writer, clock)
        writer.abandon()
        path = writer.folder / name
        data = bytearray(path.read_bytes())
        data[place] ^= 1
        path.write_bytes(data)
        run = open_run(writer.folder)
        same(run.samples("valve"), valve_batch(0, 600))
        assert verify(run)


def test_missing_and_foreign_files_are_found(tmp_path: Path) -> None:
    writer, clock = begin(tmp_path)
    fill(writer, clock)
    writer.finalize("clean")
    (writer.folder / "frames/000001.mjpg").unlink()
    (writer.folder / "samples/valve/000002.arrows").write_bytes(b"")
    (writer.folder / "notes.txt").write_text("hello")
    problems = {p.file: p.what for p in verify(open_run(writer.folder))}
    assert problems["frames/000001.mjpg"] == "missing"
    assert "has 0 of" in problems["samples/valve/000002.arrows"]
    assert "does not list" in problems["notes.txt"]


def test_a_whole_line_cut_out_of_the_middle_is_noticed(tmp_path: Path) -> None:
    writer, clock = begin(tmp_path)
    fill(writer, clock)
    writer.abandon()
    path = writer.folder / "events.jsonl"
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join(lines[:4] + lines[6:]))
    assert any("events 3 to 4 are missing" in p.what for p in verify(open_run(writer.folder)))


def test_what_is_no_run_says_so(tmp_path: Path) -> None:
    for path, what in ((tmp_path, "no run.json"), (tmp_path / "x", "no such folder")):
        with pytest.raises(RecordError, match=what):
            open_run(path)


# -- sealed JSON and Arrow messages ------------------------------------------

values = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1)
    | st.floats(allow_nan=False, allow_infinity=False) | st.text(st.characters(codec="utf-8")),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text("abc"), inner, max_size=3),
    max_leaves=8,
)  # fmt: skip


@given(st.dictionaries(st.text("abcdef", min_size=4), values, min_size=1, max_size=4))
def test_sealed_json_comes_back_and_is_plain_json(fields: dict[str, object]) -> None:
    assert open_line(seal_line(fields)) == fields
    assert open_file(seal_file(fields)) == fields
    assert seal_line(fields).count(b"\n") == 1
    for sealed in (seal_line(fields), seal_file(fields)):
        plain = json.loads(sealed)
        plain.pop("crc")
        assert plain == fields


def test_every_flipped_bit_of_sealed_json_is_noticed() -> None:
    for sealed, opened in ((seal_line({"a": 1.5}), open_line), (seal_file({"a": [1]}), open_file)):
        for bit in range(8 * len(sealed)):
            data = bytearray(sealed)
            data[bit // 8] ^= 1 << bit % 8
            with pytest.raises(SealError):
                opened(bytes(data))
        for cut in range(len(sealed)):
            with pytest.raises(SealError):
                opened(sealed[:cut])


dtypes = st.sampled_from(
    ["int8", "uint8", "int16", "uint16", "int32", "int64", "float32", "float64"]
)


@settings(deadline=None, max_examples=60)
@given(st.lists(dtypes, min_size=1, max_size=6), st.lists(st.integers(1, 40), max_size=6))
def test_messages_are_those_pyarrow_writes_and_reads(kinds: list[str], rows: list[int]) -> None:
    import pyarrow as pa

    schema = StreamSchema("s", {f"c{k}": kind for k, kind in enumerate(kinds)})
    encoder = BatchEncoder(schema)
    rng = np.random.default_rng(len(rows))
    for n in [*rows, *rows]:
        columns = {
            name: rng.integers(0, 100, n).astype(kind) for name, kind in schema.columns.items()
        }
        message, count = encoder.encode(columns)
        assert count == n
        batch = pa.RecordBatch.from_pydict(columns, schema=schema.arrow())
        assert message == batch.serialize().to_pybytes()
    assert BatchDecoder(schema, 0).columns().keys() == schema.columns.keys()


# -- kill -9 -----------------------------------------------------------------

WRITER = """
import sys, time
from pathlib import Path
from daq.clock import RealClock
from daq.record.writer import RecordWriter
from daq.link.telemetry import VALVE_COLUMNS
from daq_records import valve_batch, jpeg
writer = RecordWriter(Path(sys.argv[1]), {"protocol": "kill", "specimen": "x"}, RealClock(),
                      segment_rows=400)
writer.stream("valve", VALVE_COLUMNS)
start = time.monotonic()
k = 0
while True:
    k += 1
    time.sleep(max(0.0, start + 0.05 * k - time.monotonic()))
    writer.append("valve", valve_batch(50 * (k - 1)))
    writer.frame(jpeg(k) * 30, k)
    writer.event("tick", k=k)
    print(k, time.monotonic_ns(), flush=True)
"""


def kill_one(root: Path, after_s: float) -> None:
    """A real writer at 20 batches a second, killed; less than 0.1 s may be missing.

    Where the machine did not let the writer run for so long before the kill, nothing was
    produced that could be lost; another moment is tried.
    """
    for attempt in range(4):
        if kill_attempt(root / str(attempt), after_s + 0.037 * attempt):
            return
    pytest.fail("the writer never ran for 0.1 s on end; the machine is too busy to tell")


def kill_attempt(root: Path, after_s: float) -> bool:
    process = subprocess.Popen(
        [sys.executable, "-c", WRITER, str(root)], stdout=subprocess.PIPE, text=True, env=BESIDE
    )
    assert process.stdout is not None
    first = process.stdout.readline()
    time.sleep(after_s)
    process.send_signal(signal.SIGKILL)
    killed_ns = time.monotonic_ns()
    last = [first, *process.stdout.read().splitlines()][-1]
    process.stdout.close()
    process.wait()
    (folder,) = (p.parent for p in root.glob("*/run.json"))
    run = open_run(folder)
    assert run.outcome == "interrupted"
    seq = run.samples("valve")["seq"]
    assert seq.tolist() == list(range(len(seq)))
    np.testing.assert_array_equal(
        run.samples("valve")["counts"], valve_batch(0, len(seq))["counts"]
    )
    # Batch k holds the samples of the 50 ms before it was handed over.
    told, told_ns = (int(word) for word in last.split())
    held_back_s = (told - len(seq) / 50) * 0.05
    since_last_batch_s = (killed_ns - told_ns) * 1e-9
    assert held_back_s <= 0.05
    assert all(p.tail for p in verify(run))
    assert [e["k"] for e in run.events] == list(range(1, len(run.events) + 1))
    for meta in run.frames:
        assert run.frame_bytes(meta["frame"]) == jpeg(meta["frame"] + 1) * 30
    return held_back_s + since_last_batch_s < 0.1


@pytest.mark.realtime
@pytest.mark.skipif(sys.platform == "win32", reason="SIGKILL")
@pytest.mark.parametrize("moment", range(3))
def test_kill_9_loses_less_than_a_tenth_of_a_second(tmp_path: Path, moment: int) -> None:
    kill_one(tmp_path, random.Random(moment).uniform(0.1, 1.2))


@pytest.mark.campaign
@pytest.mark.parametrize("moment", range(20))
def test_kill_9_at_twenty_moments(tmp_path: Path, moment: int) -> None:
    kill_one(tmp_path, random.Random(100 + moment).uniform(0.0, 3.0))


# -- full disk ---------------------------------------------------------------


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A real file system of 1 MB; needs the right to mount one."""
    folder = tmp_path / "small"
    folder.mkdir()
    libc = ctypes.CDLL(None, use_errno=True) if sys.platform == "linux" else None
    if libc is None or libc.mount(b"tmpfs", bytes(folder), b"tmpfs", 0, b"size=1m") != 0:
        pytest.skip("mounting a small file system needs root on Linux")
    try:
        yield folder
    finally:
        libc.umount2(bytes(folder), 2)


@pytest.mark.parametrize("threaded", [False, True])
def test_a_full_disk_stops_the_run_loudly_and_all_before_it_is_readable(
    small_disk: Path, threaded: bool
) -> None:
    writer = RecordWriter(
        small_disk, MANIFEST, RealClock(), durable=threaded, threaded=threaded, segment_rows=1000
    )
    from daq.link.telemetry import VALVE_COLUMNS

    writer.stream("valve", VALVE_COLUMNS)
    appended = 0
    with pytest.raises(RecordError) as caught:  # noqa: PT012
        for k in range(5000):
            writer.append("valve", valve_batch(50 * k))
            appended = k + 1
            if threaded and k % 20 == 0:  # so that no more is on its way
                writer.sync()
    assert writer.failed is not None
    assert "No space left" in str(caught.value)
    assert str(writer.folder) in str(caught.value)
    assert "free some disk space" in caught.value.remedy
    writer.event("fault", code="disk_full")  # the last words have a place of their own
    writer.finalize("clean")
    run = open_run(writer.folder)
    assert run.outcome == "faulted"
    assert run.events[-1]["code"] == "disk_full"
    rows = len(run.samples("valve")["seq"])
    assert appended * 50 - 2000 < rows <= appended * 50
    same(run.samples("valve"), valve_batch(0, rows))
    assert run.final is not None
    assert "No space left" in run.final["write_failure"]["what"]
    assert any("writing failed" in p.what for p in verify(run))
    assert not (run.folder / "reserve.zero").exists()


def test_a_disk_that_is_full_from_the_start_is_refused_by_name(small_disk: Path) -> None:
    with contextlib.suppress(OSError), open(small_disk / "filler", "wb", buffering=0) as filler:
        while True:
            filler.write(bytes(4096))
    with pytest.raises(RecordError) as caught:
        begin(small_disk)
    assert str(small_disk) in str(caught.value)
    assert caught.value.remedy


LIMITED = """
import resource, sys
from pathlib import Path
from daq_records import begin, valve_batch
from daq.errors import RecordError
resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
writer, clock = begin(Path(sys.argv[1]), segment_rows=10**6)
try:
    for k in range(1000):
        writer.append("valve", valve_batch(50 * k))
except RecordError as error:
    writer.event("fault", code="disk_full")
    writer.finalize("faulted")
    print(error)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="no resource limits")
def test_a_file_that_may_not_grow_is_a_fault_that_names_file_and_remedy(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", LIMITED, str(tmp_path)],
        capture_output=True,
        text=True,
        check=True,
        env=BESIDE,
    )
    assert "000001.arrows" in done.stdout
    assert "ulimit" in done.stdout
    (folder,) = (p.parent for p in tmp_path.glob("*/final.json"))
    run = open_run(folder)
    assert run.outcome == "faulted"
    rows = len(run.samples("valve")["seq"])
    assert 2000 < rows < 2300
    assert [p.what for p in verify(run) if not p.what.startswith("writing failed")] == []


@pytest.mark.realtime
def test_a_slow_disk_does_not_hold_up_the_caller(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def slow(fd: int) -> None:
        time.sleep(1.5)

    monkeypatch.setattr(os, "fsync", slow)
    writer, _ = begin(tmp_path, durable=True, threaded=True)
    longest = 0.0
    for k in range(100):
        start = time.perf_counter()
        writer.append("valve", valve_batch(50 * k))
        writer.event("tick", k=k)
        longest = max(longest, time.perf_counter() - start)
    assert writer.sync(1.0)  # with the operating system, though the medium lags behind
    assert longest < 0.75
    assert len(open_run(writer.folder).samples("valve")["seq"]) == 5000
    monkeypatch.undo()
    writer.finalize("clean")
    assert verify(open_run(writer.folder)) == []


def test_a_disk_slower_than_the_data_is_waited_for_at_the_end_and_bounded_before_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The end of a run gave up after 30 s, and what was still queued was lost."""
    real = daq.record.disk.write_all

    def slow(fd: int, data: bytes) -> None:
        time.sleep(0.01)
        real(fd, data)

    monkeypatch.setattr(daq.record.disk, "write_all", slow)
    monkeypatch.setattr(daq.record.disk, "JOIN_S", 0.1)
    writer, _ = begin(tmp_path / "patient", durable=True, threaded=True)
    for k in range(40):
        writer.append("valve", valve_batch(50 * k))
    assert writer.finalize("clean")["outcome"] == "clean"  # 80 writes: eight times JOIN_S
    assert len(open_run(writer.folder).samples("valve")["seq"]) == 2000

    monkeypatch.setattr(daq.record.disk, "QUEUE_BYTES", 50_000)
    writer, _ = begin(tmp_path / "full", durable=True, threaded=True)
    with pytest.raises(RecordError, match="behind the data"):  # noqa: PT012
        for k in range(10_000):
            writer.append("valve", valve_batch(50 * k))
    assert writer.finalize("clean")["outcome"] == "faulted"


@pytest.mark.parametrize("threaded", [False, True])
def test_events_that_a_disk_refused_for_a_while_are_written_when_it_takes_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, threaded: bool
) -> None:
    """They were thrown away: later ones stood there, and the record had a hole in the middle."""
    real, refused = daq.record.disk.write_all, [0]

    def read_only(fd: int, data: bytes) -> None:
        refused[0] += 1
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    writer, _ = begin(tmp_path, threaded=threaded)
    writer.event("tick", k=0)
    assert writer.sync()
    monkeypatch.setattr(daq.record.disk, "write_all", read_only)
    for k in (1, 2):
        writer.event("tick", k=k)
    assert writer.sync()
    assert refused[0] >= 2
    monkeypatch.setattr(daq.record.disk, "write_all", real)
    for k in (3, 4):
        writer.event("tick", k=k)
    assert writer.finalize("clean")["outcome"] == "faulted"
    run = open_run(writer.folder)
    assert [e["k"] for e in run.events] == [0, 1, 2, 3, 4]
    assert [p.what for p in verify(run) if not p.what.startswith("writing failed")] == []


def test_a_writer_that_breaks_in_an_unforeseen_way_says_so_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    writer, _ = begin(tmp_path, threaded=True)
    writer.append("valve", valve_batch(0))
    assert writer.sync()

    def broken(*_: object) -> None:
        raise RuntimeError("unforeseen")

    monkeypatch.setattr(writer._disk, "_append", broken)
    writer.append("valve", valve_batch(50))
    assert writer.sync()
    assert "unforeseen" in str(writer.failed)
    monkeypatch.undo()
    assert writer.finalize("clean")["outcome"] == "faulted"


def test_frames_turn_over_to_a_new_file(tmp_path: Path) -> None:
    writer, clock = begin(tmp_path, frames_file_bytes=1000)
    fill(writer, clock)
    writer.finalize("clean")
    run = open_run(writer.folder)
    assert len(list((run.folder / "frames").iterdir())) == 4
    assert [run.frame_bytes(k) for k in range(12)] == [jpeg(k) for k in range(12)]
    with pytest.raises(RecordError, match="no frame 12"):
        run.frame_bytes(12)
    assert verify(run) == []


# -- cost --------------------------------------------------------------------


def test_importing_the_record_brings_in_nothing_heavy() -> None:
    modules = (
        "record.writer store.run store.store store.verify store.derive link.transport "
        "link.framer link.codec link.telemetry calibration"
    )
    code = (
        f"import sys\nfor m in {modules.split()!r}: __import__('daq.' + m)\n"
        "print([m for m in ('pyarrow', 'pandas', 'serial', 'rerun', 'cv2') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


# -- docs --------------------------------------------------------------------


def test_the_five_lines_in_the_docs_read_a_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    writer, clock = begin(tmp_path)
    fill(writer, clock)
    writer.finalize("clean")
    page = Path(__file__).parents[1] / "docs" / "reference" / "record-format.md"
    text = page.read_text("utf-8")
    code = text.split("```python\n")[1].split("```")[0]
    monkeypatch.chdir(writer.folder)
    names: dict[str, Any] = {}
    exec(code, names)
    table = names["table"]
    same({name: table[name].to_numpy() for name in table.column_names}, valve_batch(0, 600))


def test_the_sealed_forms_are_those_of_the_docs() -> None:
    import zlib

    line = seal_line({"n": 0, "kind": "state"})
    assert line == b'{"n":0,"kind":"state","crc":"%08x"}\n' % zlib.crc32(b'{"n":0,"kind":"state"')
    whole = seal_file({"n": 0})
    assert whole == b'{\n  "n": 0,\n  "crc": "%08x"\n}\n' % zlib.crc32(b'{\n  "n": 0')


def test_a_slow_disk_is_told_of_while_the_end_of_a_run_waits_for_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With 400 ms a write there was silence for 150 s."""
    writer, clock = begin(tmp_path, threaded=True)
    written = daq.record.disk.write_all

    def slow(fd: int, data: bytes) -> None:
        time.sleep(0.05)
        written(fd, data)

    monkeypatch.setattr(daq.record.disk, "write_all", slow)
    monkeypatch.setattr(daq.record.disk, "TELL_S", 0.2)
    said: list[str] = []
    writer.on_wait = said.append
    fill(writer, clock, 6)
    writer.finalize("clean")
    left = [int(text.split()[4]) for text in said]
    assert len(left) >= 2
    assert left == sorted(left, reverse=True)
    assert verify(open_run(writer.folder)) == []


def test_a_record_that_is_gone_is_not_called_safe(tmp_path: Path) -> None:
    writer, clock = begin(tmp_path)
    fill(writer, clock, 2)
    writer.finalize("clean")
    assert "checked and is sound" in record_sentence(writer.folder)
    (writer.folder / "frames/000001.mjpg").unlink()
    assert "frames/000001.mjpg" in record_sentence(writer.folder)
    shutil.rmtree(writer.folder)
    assert "no such folder" in record_sentence(writer.folder)
