"""Rows that wait for their batch: a kill does not take them along."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from daq.clock import RealClock
from daq.link.telemetry import VALVE_COLUMNS, Batch, TelemetryStream
from daq.record import disk
from daq.record.ahead import SLOTS
from daq.record.writer import RecordWriter
from daq.store.run import open_run
from daq.store.verify import verify
from daq_records import begin, valve_batch
from test_daq_telemetry import frame


def assert_rows(folder: Path, rows: int) -> None:
    found = open_run(folder).samples("valve")
    expected = valve_batch(0, rows)
    for name, values in expected.items():
        np.testing.assert_array_equal(found[name], values, err_msg=name)
        assert found[name].dtype == values.dtype


def test_rows_ahead_of_their_batch_are_with_the_operating_system_at_once(tmp_path: Path) -> None:
    writer, _ = begin(tmp_path)
    writer.append("valve", valve_batch(0))
    for k in range(50, 57):
        writer.write_ahead("valve", valve_batch(k, 1))
        assert_rows(writer.folder, k + 1)  # another reader, while the writer has it open
    writer.abandon()
    assert_rows(writer.folder, 57)
    assert verify(open_run(writer.folder)) == []


def test_rows_are_there_before_the_first_batch_too(tmp_path: Path) -> None:
    writer, _ = begin(tmp_path)
    writer.write_ahead("valve", valve_batch(0, 3))
    writer.abandon()
    assert_rows(writer.folder, 3)


def test_a_finished_run_holds_each_row_once_and_no_such_file(tmp_path: Path) -> None:
    writer, _ = begin(tmp_path)
    for first in (0, 50):
        for k in range(first, first + 50, 10):
            writer.write_ahead("valve", valve_batch(k, 10))
        writer.append("valve", valve_batch(first))
    writer.finalize("clean")
    assert_rows(writer.folder, 100)
    assert not list(writer.folder.rglob("*.ahead"))
    assert verify(open_run(writer.folder)) == []


@given(st.lists(st.tuples(st.integers(1, 9), st.booleans()), max_size=12))
@settings(max_examples=15, deadline=None)
def test_whatever_the_order_of_rows_and_batches_all_are_read(
    tmp_path_factory: pytest.TempPathFactory, steps: list[tuple[int, bool]]
) -> None:
    writer, _ = begin(tmp_path_factory.mktemp("r"), segment_rows=20)
    given_rows = batched = 0
    for rows, full in steps:
        writer.write_ahead("valve", valve_batch(given_rows, rows))
        given_rows += rows
        if full:
            writer.append("valve", valve_batch(batched, given_rows - batched))
            batched = given_rows
    writer.abandon()
    if given_rows:
        assert_rows(writer.folder, given_rows)


def test_a_kill_between_a_batch_and_the_cut_leaves_no_row_twice(tmp_path: Path) -> None:
    writer, _ = begin(tmp_path)
    writer.write_ahead("valve", valve_batch(0, 50))
    kept = (writer.folder / "samples/valve.ahead").read_bytes()
    writer.append("valve", valve_batch(0))
    writer.abandon()
    (writer.folder / "samples/valve.ahead").write_bytes(kept)
    assert_rows(writer.folder, 50)
    assert open_run(writer.folder).lost_rows("valve") == []


def test_a_torn_entry_ends_what_is_read_and_is_told(tmp_path: Path) -> None:
    writer, _ = begin(tmp_path)
    for k in range(3):
        writer.write_ahead("valve", valve_batch(k, 1))
    writer.abandon()
    path = writer.folder / "samples/valve.ahead"
    data = bytearray(path.read_bytes())
    end = len(bytes(data).rstrip(b"\x00"))
    data[end - 5 : end] = bytes(5)
    path.write_bytes(data)
    assert_rows(writer.folder, 2)
    (problem,) = verify(open_run(writer.folder))
    assert problem.tail
    assert problem.file == "samples/valve.ahead"


def test_rows_that_are_missing_before_them_are_named(tmp_path: Path) -> None:
    """As a power cut may leave it: the later file reached the medium, the earlier did not."""
    writer, _ = begin(tmp_path)
    writer.append("valve", valve_batch(0))
    writer.append("valve", valve_batch(50))
    writer.write_ahead("valve", valve_batch(100, 5))
    writer.abandon()
    index = writer.folder / "samples/valve.index.jsonl"
    index.write_bytes(b"".join(index.read_bytes().splitlines(keepends=True)[:-1]))
    run = open_run(writer.folder)
    assert run.samples("valve")["seq"].tolist() == [*range(50), *range(100, 105)]
    assert run.lost_rows("valve") == [(50, 100)]
    assert any("rows 50 to 99 are lost" in p.what for p in verify(run))


def test_while_the_disk_is_behind_the_caller_goes_on_and_what_fits_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Eight batches without one of them on disk: then rows are left out, and none is wrong."""
    writer = RecordWriter(tmp_path, {}, RealClock(), durable=False)
    writer.stream("valve", VALVE_COLUMNS)
    writer.append("valve", valve_batch(0))
    writer.write_ahead("valve", valve_batch(50, 10))
    assert writer.sync()
    stuck, plain = threading.Event(), disk.write_all

    def waiting(fd: int, data: bytes) -> None:
        stuck.wait(20.0)
        plain(fd, data)

    monkeypatch.setattr(disk, "write_all", waiting)
    for first in range(50, 600, 50):
        for k in range(first + 10 * (first == 50), first + 50, 10):
            writer.write_ahead("valve", valve_batch(k, 10))
        writer.append("valve", valve_batch(first))
    assert_rows(writer.folder, 50 + SLOTS * 50)  # only the first batch is on disk
    stuck.set()
    assert writer.sync()
    assert_rows(writer.folder, 600)
    writer.write_ahead("valve", valve_batch(600, 10))  # slots are free again after the next batch
    writer.append("valve", valve_batch(600))
    writer.write_ahead("valve", valve_batch(650, 10))
    assert writer.sync()
    assert_rows(writer.folder, 660)
    writer.abandon()


def test_columns_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    writer, _ = begin(tmp_path)
    rows = valve_batch(0, 2)
    with pytest.raises(ValueError, match="column flags is missing"):
        writer.write_ahead("valve", {k: v for k, v in rows.items() if k != "flags"})
    writer.abandon()


def test_frames_ahead_are_the_rows_that_their_batch_brings() -> None:
    batches: list[Batch] = []
    ahead: list[Batch] = []
    stream = TelemetryStream(batches.append)
    stream.on_ahead = ahead.append
    for k in range(0, 100, 10):
        stream.feed(frame(k), (k + 1) * 1_000_000)
    assert len(ahead) == 10
    for name in batches[0]:
        whole = np.concatenate([b[name] for b in batches])
        np.testing.assert_array_equal(np.concatenate([a[name] for a in ahead]), whole)
        assert ahead[0][name].dtype == whole.dtype


KILLED = """
import os, signal, sys
from daq_records import begin, valve_batch
from daq.clock import RealClock
from daq.record.writer import RecordWriter
from daq.link.telemetry import VALVE_COLUMNS
writer = RecordWriter(sys.argv[1], {}, RealClock())
writer.stream("valve", VALVE_COLUMNS)
for k in range(173):
    writer.write_ahead("valve", valve_batch(k, 1))
    if k % 50 == 49:
        writer.append("valve", valve_batch(k - 49))
assert writer.sync()
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_batch_is_safe_before_the_disk_has_come_to_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It was lost while the writer's thread was held up."""
    writer = RecordWriter(tmp_path, {}, RealClock(), durable=False)
    writer.stream("valve", VALVE_COLUMNS)
    assert writer.sync()
    stuck, plain = threading.Event(), disk.write_all

    def waiting(fd: int, data: bytes) -> None:
        stuck.wait(20.0)
        plain(fd, data)

    monkeypatch.setattr(disk, "write_all", waiting)
    writer.append("valve", valve_batch(0))
    writer.append("valve", valve_batch(50, 7))
    assert_rows(writer.folder, 57)
    stuck.set()
    assert writer.sync()
    writer.abandon()
    assert_rows(writer.folder, 57)
    assert verify(open_run(writer.folder)) == []


@pytest.mark.skipif(sys.platform == "win32", reason="SIGKILL")
def test_kill_9_takes_no_row_that_was_handed_over(tmp_path: Path) -> None:
    here = Path(__file__).parent
    done = subprocess.run(
        [sys.executable, "-c", KILLED, str(tmp_path)], cwd=here, check=False, capture_output=True
    )
    assert done.returncode == -signal.SIGKILL, done.stderr
    (folder,) = (p.parent for p in tmp_path.glob("*/run.json"))
    assert open_run(folder).outcome == "interrupted"
    assert_rows(folder, 173)


def test_the_first_batch_of_a_run_does_not_import_pandas(tmp_path: Path) -> None:
    """It takes a second and more: so long a host would send no heartbeat."""
    code = KILLED.split("for k", maxsplit=1)[0] + (
        "writer.append('valve', valve_batch(0))\nwriter.finalize('clean')\n"
        "assert 'pandas' not in sys.modules\n"
    )
    here = Path(__file__).parent
    subprocess.run([sys.executable, "-c", code, str(tmp_path)], cwd=here, check=True)


def test_a_writer_with_threads_gives_up_the_file_as_well(tmp_path: Path) -> None:
    writer = RecordWriter(tmp_path, {}, RealClock(), durable=True, threaded=True)
    writer.stream("place", {"row": "int64"})
    writer.write_ahead("place", {"row": np.arange(4)})
    writer.append("place", {"row": np.arange(4)})
    writer.finalize("clean")
    assert not list(writer.folder.rglob("*.ahead"))


def test_a_folder_that_comes_up_meanwhile_is_no_fault(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two threads open the first files of `samples`: rows ahead and the first batch's index."""
    there = Path.exists

    def late(path: Path) -> bool:
        known = there(path)
        if path.name == "samples" and not known:
            path.mkdir()  # the other thread, between the question and the answer
        return known

    files = disk.Disk(tmp_path, {"run_id": "a"}, durable=False, threaded=False)
    monkeypatch.setattr(Path, "exists", late)
    files.put("samples/bench.index.jsonl", b"{}\n")
    assert files.failed is None
    assert (tmp_path / "samples" / "bench.index.jsonl").read_bytes() == b"{}\n"
    files.close()
