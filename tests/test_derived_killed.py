"""The program dies while it makes the derived files of a run: the record is not touched by it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from typer.testing import CliRunner

from cli.main import app
from daq.store.derive import derive
from daq.store.run import PARTIAL, open_run
from daq.store.verify import verify
from daq_records import begin, fill

STALL = """
import sys, time
from pathlib import Path
from daq.store.derive import derive
from daq.store.run import open_run

def stall(run, out):
    (out / "table.csv").write_text("half a tab")
    print("stalled", flush=True)
    time.sleep(60)

derive(open_run(sys.argv[1]), [stall])
"""


@pytest.fixture
def killed(tmp_path: Path) -> Path:
    """A finished run with derived files, and the new ones that a kill left half made."""
    writer, clock = begin(tmp_path / "runs")
    fill(writer, clock, 3)
    writer.finalize("clean")
    derive(open_run(writer.folder))
    command = [sys.executable, "-c", STALL, str(writer.folder)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "stalled\n"
        os.kill(process.pid, signal.SIGKILL)
    return writer.folder


def test_a_kill_leaves_the_old_files_whole_and_is_reported(killed: Path) -> None:
    """A folder `derived.partial` stayed in the record and nothing said what it was."""
    assert (killed / PARTIAL / "table.csv").read_text() == "half a tab"
    run = open_run(killed)
    assert run.derived("samples.parquet").is_file()
    problems = verify(run)
    assert {p.file.split("/")[0] for p in problems} == {PARTIAL}
    assert all(p.tail and "not completed" in p.what for p in problems)
    said = CliRunner().invoke(app, ["runs", "verify", str(killed)])
    assert said.exit_code == 1  # something was found
    assert "derived files that were not completed" in said.output


def test_the_next_derived_files_take_their_place(killed: Path) -> None:
    before = time.time()
    derive(open_run(killed))
    assert not (killed / PARTIAL).exists()
    assert (killed / "derived/manifest.json").stat().st_mtime > before - 2.0
    assert verify(open_run(killed)) == []
