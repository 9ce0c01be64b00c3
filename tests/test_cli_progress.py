"""The progress line: on a terminal only, gone when the command prints; Ctrl-C loses nothing."""

from __future__ import annotations

import contextlib
import io
import os
import pty
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from cli import progress
from cli.progress import counting, progress_line
from cli.protocols import terminal as terminal_lines
from cli.protocols.terminal import ProgressLine
from daq.progress import counted, stage
from daq.store.run import open_run
from daq.store.verify import verify
from protocol_runs import run_short
from rigs.steps.watching import Progress


class Terminal(io.StringIO):
    """Takes what is written, and says that it is a terminal."""

    def isatty(self) -> bool:
        return True


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Terminal:
    """A stderr that is a terminal; the line is drawn often."""
    made = Terminal()
    monkeypatch.setattr(progress, "sys", SimpleNamespace(stderr=made, stdout=io.StringIO()))
    monkeypatch.setattr(progress, "AFTER_S", 0.01)
    monkeypatch.setattr(progress, "EVERY_S", 0.01)
    monkeypatch.setattr(progress, "SECONDS_FROM_S", 0.0)
    return made


def wait_for(terminal: Terminal, text: str) -> None:
    end = time.monotonic() + 5.0
    while text not in terminal.getvalue():
        assert time.monotonic() < end, terminal.getvalue()
        time.sleep(0.005)


def test_stages_from_deep_inside_stand_on_the_line_and_it_is_cleared(terminal: Terminal) -> None:
    with progress_line("making the report"):
        wait_for(terminal, "making the report  0 s")
        for _ in counted("fit", [1, 2]):
            pass
        wait_for(terminal, "fit 2 of 2")
    last = terminal.getvalue().split("\r")
    assert last[-1] == ""
    assert last[-2].strip() == ""


def test_an_error_clears_the_line_before_it_is_printed(terminal: Terminal) -> None:
    def fail() -> None:
        with progress_line("work"):
            wait_for(terminal, "work")
            raise ValueError("bad")

    with pytest.raises(ValueError, match="bad"):
        fail()
    assert terminal.getvalue().split("\r")[-2].strip() == ""


def test_what_is_quick_or_not_on_a_terminal_shows_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    quick = Terminal()
    monkeypatch.setattr(sys, "stderr", quick)
    with progress_line("quick"):
        stage("done at once")
    assert quick.getvalue() == ""
    file = io.StringIO()
    monkeypatch.setattr(sys, "stderr", file)
    monkeypatch.setattr(progress, "AFTER_S", 0.0)
    with progress_line("in a script") as say:
        say("still")
        time.sleep(0.02)
    assert file.getvalue() == ""


class Clock:
    """Stands for the module `time`: it stands still until it is moved."""

    def __init__(self) -> None:
        self.now = 1000.0

    def monotonic(self) -> float:
        return self.now


def a_test_of_two_hours(line: ProgressLine, clock: Clock, every_s: float) -> None:
    """Shows 24 trials of 5 minutes, with a state each and a point every `every_s` seconds."""
    shown = Progress(points=24 * round(300 / every_s), seconds=7200.0)
    rig = SimpleNamespace(clock=SimpleNamespace(virtual=False))
    line.start(SimpleNamespace(progress=shown, rig=rig), SimpleNamespace(folder="runs/r"))  # type: ignore[arg-type]
    watch = line.watch()
    for trial in range(1, 25):
        shown.state = f"trial {trial}"
        watch.state(shown.state)
        for _ in range(round(300 / every_s)):
            clock.now += every_s
            shown.done, shown.spent_s = shown.done + 1, shown.spent_s + every_s
            watch.point(None, 0.0, 0.0, 0.0)  # type: ignore[arg-type]
    watch.log("NOTE: over")
    line.close()


def test_a_test_in_a_file_writes_few_lines_and_no_carriage_return(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    file, clock = io.StringIO(), Clock()
    monkeypatch.setattr(sys, "stderr", file)
    monkeypatch.setattr(terminal_lines, "time", clock)
    a_test_of_two_hours(ProgressLine(quiet=False), clock, 1.0)
    text = file.getvalue()
    assert "\r" not in text
    lines = text.splitlines()
    assert lines[1].startswith("  trial 1  0/7200 points")
    assert lines[-1] == "NOTE: over"
    # One for each 10 s until 200 s, then for each twentieth of the time since the start.
    assert 60 < len(lines) < 120
    assert len(set(lines)) == len(lines)


def test_a_test_at_a_terminal_draws_one_line_and_messages_stand_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made, clock = Terminal(), Clock()
    monkeypatch.setattr(sys, "stderr", made)
    monkeypatch.setattr(terminal_lines, "time", clock)
    a_test_of_two_hours(ProgressLine(quiet=False), clock, 30.0)
    first, *drawn = made.getvalue().split("\r")
    assert first.splitlines()[0] == "recording to runs/r"
    assert len(drawn) > 200
    last, message = drawn[-1].splitlines()
    assert last.rstrip() == "trial 24  240/240 points"
    assert message == "NOTE: over"


def test_rows_are_counted_where_they_do_not_appear_themselves(terminal: Terminal) -> None:
    seen = []
    for item in counting(range(3), "frames"):
        seen.append(item)
        wait_for(terminal, f"frames: {item + 1}")
    assert seen == [0, 1, 2]


@pytest.mark.parametrize("stages", [0, 1])
def test_ctrl_c_that_a_library_swallowed_counts_at_the_next_stage_or_at_the_end(
    terminal: Terminal, stages: int, request: pytest.FixtureRequest
) -> None:
    """A report went on, with status 0, when it was pressed in the middle of an import."""
    del terminal
    reached: list[str] = []
    # A shell starts what runs in the background with SIGINT ignored.
    started_with = signal.signal(signal.SIGINT, signal.default_int_handler)
    request.addfinalizer(lambda: signal.signal(signal.SIGINT, started_with))
    before = signal.getsignal(signal.SIGINT)

    def command() -> None:
        with progress_line("report"):
            with contextlib.suppress(KeyboardInterrupt):
                signal.raise_signal(signal.SIGINT)
            for _ in range(stages):
                stage("the next one")
                reached.append("beyond")

    with pytest.raises(KeyboardInterrupt):
        command()
    assert reached == []
    assert signal.getsignal(signal.SIGINT) is before


def test_a_report_stopped_by_ctrl_c_leaves_record_and_old_report(tmp_path: Path) -> None:
    _, run, _ = run_short("switching-time", tmp_path, pressures_kpa=(200.0,), repeats=1)
    derived = run.folder / "derived"
    shutil.rmtree(derived, ignore_errors=True)
    derived.mkdir()
    (derived / "report.html").write_text("the old one")
    ours, theirs = pty.openpty()
    command = [sys.executable, "-c", "from cli.main import main; main()", "report", str(run.folder)]

    def heeded() -> None:
        """A shell starts what runs in the background with SIGINT ignored, and so would this."""
        signal.signal(signal.SIGINT, signal.SIG_DFL)

    with subprocess.Popen(
        command, stderr=theirs, stdout=subprocess.PIPE, preexec_fn=heeded
    ) as process:
        os.close(theirs)
        shown = b""
        while b"making table" not in shown:
            shown += os.read(ours, 1000)
        process.send_signal(signal.SIGINT)
        assert process.wait(60.0) == 130
        assert process.stdout is not None
        assert b"Traceback" not in process.stdout.read()
    os.close(ours)
    assert (derived / "report.html").read_text() == "the old one"
    assert [p for p in verify(open_run(run.folder)) if not p.file.startswith("derived")] == []
