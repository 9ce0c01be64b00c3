"""Rows given one by one: safe when the call returns, joined into batches, read back as given."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from daq.clock import VirtualClock
from daq.record.ahead import SLOT_BYTES
from daq.record.rows import RowWriter
from daq.record.writer import RecordWriter
from daq.store.run import Run, open_run
from daq.store.verify import verify

BATCH_ROWS = SLOT_BYTES // (20 + 8 + 8 + 2 + 4 + 1)
SCHEMA = {"row": "int64", "level": "float64", "counts": "uint16", "small": "float32", "on": "uint8"}


def begin(root: Path) -> tuple[RecordWriter, RowWriter, VirtualClock]:
    clock = VirtualClock()
    record = RecordWriter(root, {"protocol": "rows"}, clock, durable=False, threaded=False)
    return record, RowWriter(record, clock, "bench", SCHEMA, {"level": "kPa"}), clock


def given_row(number: int) -> tuple[int, float, int, float, bool]:
    return number, number * 0.1, number % 65536, number / 4, number % 2 == 0


def assert_rows(run: Run, rows: int) -> None:
    found = run.samples("bench")
    expected = list(zip(*(given_row(k) for k in range(rows)), strict=True))
    assert {n: str(c.dtype) for n, c in found.items()} == SCHEMA
    for name, values in zip(SCHEMA, expected, strict=True):
        np.testing.assert_array_equal(found[name], np.array(values, dtype=SCHEMA[name]))
    assert verify(run) == []


def batches(run: Run) -> list[int]:
    entries = run.index("bench").entries
    return [e.fields["rows"] for e in entries if e.fields["chunk"] == "rows"]


def test_a_row_is_with_the_operating_system_when_the_call_returns(tmp_path: Path) -> None:
    record, rows, _ = begin(tmp_path)
    for k in range(2 * BATCH_ROWS + 7):
        assert rows.add(given_row(k)) == k
        if k in (0, 1, 2, BATCH_ROWS - 1, BATCH_ROWS, BATCH_ROWS + 1, BATCH_ROWS + 9):
            assert_rows(open_run(record.folder), k + 1)  # by another reader
    record.abandon()
    assert_rows(open_run(record.folder), 2 * BATCH_ROWS + 7)


def test_rows_that_come_fast_share_a_batch_and_one_that_comes_alone_has_its_own(
    tmp_path: Path,
) -> None:
    record, rows, clock = begin(tmp_path)
    for k in range(3):
        clock.sleep(1.0)
        rows.add(given_row(k))
    for k in range(3, 3 + 2 * BATCH_ROWS):
        clock.sleep(0.0001)
        rows.add(given_row(k))
    rows.add(given_row(3 + 2 * BATCH_ROWS))
    rows.flush()
    rows.flush()
    record.finalize("clean")
    run = open_run(record.folder)
    assert batches(run) == [1, 1, 1, BATCH_ROWS, BATCH_ROWS, 1]
    assert_rows(run, 4 + 2 * BATCH_ROWS)
    assert not list(record.folder.rglob("*.ahead"))


def test_a_batch_is_due_after_50_ms(tmp_path: Path) -> None:
    record, rows, clock = begin(tmp_path)
    for k in range(12):
        clock.sleep(0.01)
        rows.add(given_row(k))
    record.abandon()
    assert batches(open_run(record.folder)) == [1, 6]  # 10 ms; 20 to 70 ms; the rest waits
    assert_rows(open_run(record.folder), 12)


@given(st.lists(st.tuples(st.floats(0.0, 0.2), st.booleans()), max_size=40), st.booleans())
@settings(max_examples=15, deadline=None)
def test_whatever_the_times_every_row_is_read(
    tmp_path_factory: pytest.TempPathFactory, steps: list[tuple[float, bool]], ended: bool
) -> None:
    record, rows, clock = begin(tmp_path_factory.mktemp("r"))
    for number, (wait_s, flush) in enumerate(steps):
        clock.sleep(wait_s)
        rows.add(given_row(number))
        if flush:
            rows.flush()
    if ended:
        rows.flush()
        record.finalize("clean")
    else:
        record.abandon()
    if steps:
        assert_rows(open_run(record.folder), len(steps))


def test_rows_too_wide_for_fifty_in_a_slot_make_smaller_batches(tmp_path: Path) -> None:
    record = RecordWriter(tmp_path, {}, VirtualClock(), durable=False, threaded=False)
    names = {f"c{k}": "float64" for k in range(100)}
    rows = RowWriter(record, VirtualClock(), "wide", names)
    for k in range(25):
        rows.add([k] * 100)
        assert len(open_run(record.folder).samples("wide")["c0"]) == k + 1
    record.abandon()
    assert batches_of(record.folder)[1] == SLOT_BYTES // (20 + 800)


def batches_of(folder: Path) -> list[int]:
    entries = open_run(folder).index("wide").entries
    return [e.fields["rows"] for e in entries if e.fields["chunk"] == "rows"]


@pytest.mark.parametrize(
    "values",
    [(1, 2.0, 3), (1, 2.0, 3, 4.0, True, 6), (1.5, 2.0, 3, 4.0, 1), (1, 2.0, 70_000, 4, 1)],
)
def test_what_is_no_row_is_refused_and_nothing_is_lost_by_it(
    tmp_path: Path, values: tuple[float, ...]
) -> None:
    record, rows, _ = begin(tmp_path)
    rows.add(given_row(0))
    with pytest.raises(ValueError, match=r"stream bench: .* is not a row of it"):
        rows.add(values)
    rows.add(given_row(1))
    record.abandon()
    assert_rows(open_run(record.folder), 2)


def test_what_the_docs_show_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = (Path(__file__).parent.parent / "docs" / "reference" / "record-format.md").read_text()
    (block,) = re.findall(r"## Record something else\n\n```python\n(.*?)```", page, re.S)
    monkeypatch.chdir(tmp_path)
    exec(block, {})
    (folder,) = (p.parent for p in tmp_path.glob("runs/*/run.json"))
    np.testing.assert_allclose(open_run(folder).samples("strain")["strain"], np.arange(100) * 1e-3)


KILLED = """
import os, signal, sys, time
from daq.clock import RealClock
from daq.record.writer import RecordWriter
from daq.record.rows import RowWriter
from test_daq_rows import SCHEMA, given_row
record = RecordWriter(sys.argv[1], {}, RealClock())
record._disk.call_after_writes(lambda: time.sleep(float(sys.argv[2])))
rows = RowWriter(record, RealClock(), "bench", SCHEMA)
for k in range(300):
    rows.add(given_row(k))
os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="SIGKILL")
@pytest.mark.parametrize("held_up_s", [0.0, 0.3])
def test_kill_9_takes_no_row_whose_call_has_returned(tmp_path: Path, held_up_s: float) -> None:
    """Not a moment is given to the thread that writes batches, though it may be late already."""
    here = Path(__file__).parent
    done = subprocess.run(
        [sys.executable, "-c", KILLED, str(tmp_path), str(held_up_s)],
        cwd=here, check=False, capture_output=True,
    )  # fmt: skip
    assert done.returncode == -signal.SIGKILL, done.stderr
    (folder,) = (p.parent for p in tmp_path.glob("*/run.json"))
    found = open_run(folder).samples("bench")
    np.testing.assert_array_equal(found["row"], np.arange(300))
