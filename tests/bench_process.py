"""The bench as a process of its own on pseudo-terminals, and clients beside it."""

from __future__ import annotations

import contextlib
import io
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

ATTEMPTS = 3
STARVED_MS = 150.0
LIMIT_S = 600.0
"""Longest that one command may take on a machine that has other things to do."""
BUSY = frozenset({"no_answer", "late", "silent", "half", "stale"})
"""What a line suffers from when the computer at either end of it is kept from its work: told,
counted, and never taken for a reading."""
START_S = 900.0
"""A fresh clone compiles the simulation first, beside others on a busy machine; a bench that dies
meanwhile is noticed at once."""


def pamrig(*words: str | Path, **options: Any) -> subprocess.Popen[str]:
    """Start the command line as a user would."""
    return subprocess.Popen(
        [sys.executable, "-m", "cli.main", *map(str, words)],
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        **options,
    )


def run_pamrig(
    *words: str | Path, limit_s: float = LIMIT_S, **options: Any
) -> subprocess.CompletedProcess[str]:
    """Run the command line to its end."""
    return subprocess.run(
        [sys.executable, "-m", "cli.main", *map(str, words)],
        text=True,
        capture_output=True,
        timeout=limit_s,
        check=False,
        **options,
    )


def call_pamrig(*words: str | Path) -> subprocess.CompletedProcess[str]:
    """Run the command line to its end without a process of its own: seconds less of starting."""
    from cli.main import main

    out, err, status = io.StringIO(), io.StringIO(), 0
    given = ["pamrig", *map(str, words)]
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(sys, "argv", given)
                main()
        except SystemExit as ended:
            status = ended.code if isinstance(ended.code, int) else int(ended.code is not None)
    return subprocess.CompletedProcess(given, status, out.getvalue(), err.getvalue())


@dataclass
class BenchProcess:
    """A running `pamrig virtual`."""

    process: subprocess.Popen[str]
    folder: Path

    @property
    def rig(self) -> Path:
        """The rig file that its clients use."""
        return self.folder / "rig.toml"

    def truth(self) -> list[dict[str, Any]]:
        """The true states written so far, oldest first."""
        lines = (self.folder / "truth.jsonl").read_text().splitlines()
        return [json.loads(line) for line in lines if line.endswith("}")]

    def lately(self) -> list[dict[str, Any]]:
        """The last few of them, without reading all that came before; empty at the beginning."""
        with (self.folder / "truth.jsonl").open("rb") as file:
            file.seek(max(0, file.seek(0, os.SEEK_END) - 2048))
            lines = file.read().decode().splitlines()
        return [json.loads(line) for line in lines if line[:1] == "{" and line[-1:] == "}"]

    def stop(self) -> str:
        """End it as Ctrl-C does; what it said."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        out, _ = self.process.communicate(timeout=LIMIT_S)
        return out


@contextlib.contextmanager
def bench_process(folder: Path, rig: str = "virtual", *more: str) -> Iterator[BenchProcess]:
    """`pamrig virtual` on ports in ``folder``, ready to be opened."""
    folder.mkdir(parents=True, exist_ok=True)
    process = pamrig(
        "virtual", "--rig", rig, "--dir", folder, "--truth", folder / "truth.jsonl", *more,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )  # fmt: skip
    bench = BenchProcess(process, folder)
    try:
        end = time.monotonic() + START_S
        assert process.stdout is not None
        said = ""
        while "try:" not in (line := process.stdout.readline()):
            said += line
            assert line or process.poll() is None, (said, process.communicate())
            assert time.monotonic() < end, f"the bench did not start; it said: {said}"
        yield bench
    finally:
        if process.poll() is None:
            bench.stop()
        for stream in (process.stdout, process.stderr):
            if stream is not None:
                stream.close()


@dataclass
class RealRun:
    """A test that ran to its end over ports, in real time.

    Attributes:
        done: what the program said.
        folder: its record.
        worst_late_ms: how late the bench's own loop once was.
    """

    done: subprocess.CompletedProcess[str]
    folder: Path
    worst_late_ms: float


def worst_late_ms(words: str) -> float:
    """How late the bench's loop once was, from what it says at its end."""
    found = re.search(r"worst ([\d.]+) ms", words)
    assert found, words
    return float(found[1])


def starved(status: int, said: str, bench_late_ms: float) -> bool:
    """Whether a run was refused or ended because the machine had no time for it.

    The firmware vents under a program that is not given the processor for 0.3 s. Where even the
    bench's loop, which has nothing to wait for, once stood still for half of that, devices may
    have answered too late as well. Such a run is made again.
    """
    return status == 2 and ("host_silent" in said or bench_late_ms >= STARVED_MS)


def check_ended_well(runs: Path) -> None:
    """What holds of every starved run: it says so, its record is whole, the muscle was vented."""
    from daq.store.run import open_run
    from daq.store.verify import verify

    for folder in runs.glob("*/run.json"):
        run = open_run(folder.parent)
        assert run.outcome == "faulted"
        assert verify(run) == []
        if [e for e in run.events if e["kind"] == "armed"]:
            assert [e for e in run.events if e["kind"] == "vented"]


def run_folder(runs: Path) -> Path:
    """The one run in there."""
    (folder,) = (path for path in runs.iterdir() if path.is_dir())
    return folder


def gave_up(said: str, late_ms: list[float]) -> AssertionError:
    """No attempt came to its end: a failure, unless the bench itself was held up each time."""
    words = f"starved {len(late_ms)} times, bench late by {late_ms} ms at worst: {said}"
    if min(late_ms) >= STARVED_MS:
        pytest.skip(f"this machine is too busy for a bench in real time; {words}")
    return AssertionError(words)


def run_in_real_time(
    root: Path, rig: str, name: str, *words: str | Path, bench: tuple[str, ...] = (), **options: Any
) -> RealRun:
    """`pamrig NAME` over the ports of a bench of its own, again where the machine was too busy."""
    late_ms: list[float] = []
    for attempt in range(ATTEMPTS):
        place = root / str(attempt)
        with bench_process(place / "bench", rig, *bench) as process:
            done = run_pamrig(
                name, "--rig", process.rig, "--out", place / "runs", *words, **options
            )  # fmt: skip
            late_ms.append(worst_late_ms(process.stop()))
        if not starved(done.returncode, done.stdout, late_ms[-1]):
            assert done.returncode == 0, done.stdout + done.stderr
            return RealRun(done, run_folder(place / "runs"), late_ms[-1])
        check_ended_well(place / "runs")
    raise gave_up(done.stdout + done.stderr, late_ms)
