"""The bench as a process of its own on pseudo-terminals, and clients beside it."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

START_S = 900.0
"""A fresh clone compiles the simulation first, beside others on a busy machine; a bench that dies
meanwhile is noticed at once."""


def pamrig(*words: str | Path, **options: Any) -> subprocess.Popen[str]:
    """Start the command line as a user would."""
    return subprocess.Popen(
        [sys.executable, "-m", "rigs.cli", *map(str, words)],
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        **options,
    )


def run_pamrig(
    *words: str | Path, limit_s: float = 300.0, **options: Any
) -> subprocess.CompletedProcess[str]:
    """Run the command line to its end."""
    return subprocess.run(
        [sys.executable, "-m", "rigs.cli", *map(str, words)],
        text=True,
        capture_output=True,
        timeout=limit_s,
        check=False,
        **options,
    )


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

    def stop(self) -> str:
        """End it as Ctrl-C does; what it said."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        out, _ = self.process.communicate(timeout=20)
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
