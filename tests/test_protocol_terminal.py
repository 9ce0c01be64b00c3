"""Keys and answers typed at a terminal during a test, on a pseudo-terminal."""

from __future__ import annotations

import os
import select
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from daq.store.run import Run, open_run
from daq.store.store import list_runs

HOUSE = Path(__file__).resolve().parent.parent

pytestmark = pytest.mark.skipif(os.name != "posix", reason="needs a pseudo-terminal")


def at_the_terminal(folder: Path, arguments: list[str], answers: list[tuple[str, str]]) -> str:
    """Run a command on a pseudo-terminal; type each answer once its text has been printed."""
    import pty

    ours, theirs = pty.openpty()
    program = subprocess.Popen(
        [sys.executable, "-m", "cli.main", *arguments], cwd=folder,
        env={**os.environ, "PYTHONPATH": str(HOUSE)},
        stdin=theirs, stdout=theirs, stderr=theirs, start_new_session=True,
    )  # fmt: skip
    os.close(theirs)
    shown, seen, left = "", 0, list(answers)
    end = time.monotonic() + 120.0
    try:
        while time.monotonic() < end:
            if not select.select([ours], [], [], 1.0)[0]:
                continue
            try:
                data = os.read(ours, 65536)
            except OSError:  # Linux: the other side is closed
                break
            shown += data.decode(errors="replace")
            while left and (at := shown.find(left[0][0], seen)) >= 0:
                seen = at + len(left[0][0])
                os.write(ours, f"{left.pop(0)[1]}\n".encode())
        program.wait(30)
    finally:
        os.close(ours)
        if program.poll() is None:
            program.kill()
            program.wait()
    assert not left, f"never shown: {left[0][0]!r}\n{shown}"
    return shown


def the_run(folder: Path) -> Run:
    (info,) = list_runs(folder / "runs")
    return open_run(info.folder)


def events(run: Run, kind: str) -> list[dict[str, Any]]:
    return [event for event in run.events if event["kind"] == kind]


def test_the_default_rig_shows_the_keys_and_obeys_them(tmp_path: Path) -> None:
    shown = at_the_terminal(
        tmp_path, ["isometric", "--protocol", "isometric-short"],
        [("keys, then Enter: p pause", "m door opened"), ("marked: door opened", "q")],
    )  # fmt: skip
    run = the_run(tmp_path)
    assert run.outcome == "stopped", shown
    assert [event["text"] for event in events(run, "marker")] == ["door opened"]
    assert "stop requested" in shown


def test_a_wrong_answer_at_a_prompt_is_asked_again_and_keys_work_there(tmp_path: Path) -> None:
    shown = at_the_terminal(
        tmp_path, ["isotonic", "--rig", "virtual-weights", "--protocol", "isotonic-weights"],
        [
            (">> hang 0.714 kg", "0.714 kilos"),
            (">> '0.714 kilos' is neither Enter nor a number in kg. Your answer:", "p"),
            ("paused (p goes on); the open request stays", "p"),
            ("the test goes on; the open request stays", "0,714"),
            (">> set the catch", "q"),
        ],
    )  # fmt: skip
    run = the_run(tmp_path)
    assert shown.count("hang 0.714 kg") == 1
    assert run.outcome == "stopped", shown
    assert events(run, "load")[0]["mass_kg"] == 0.714
