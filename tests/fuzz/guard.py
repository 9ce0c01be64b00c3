"""Looks after the process that fuzzes a target: crashes, hangs, memory; and goes on after each."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil

from .worker import Now

HOUSE = Path(__file__).resolve().parent.parent.parent
HANG_S = 10.0
"""Processor time; twice what the loop itself allows, in which Python would come to its alarm."""
ASLEEP = 12
"""So many times as long may one input sleep: a busy machine makes a process wait as well."""
START_S = 600.0
MORE_MB = 300.0
MOST_DEATHS = 10
STEP = 20_000
FAST = "/dev/shm"
"""Where there is memory in place of a disk: what reads files writes one for each input."""
QUIET = {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1", "OPENCV_LOG_LEVEL": "SILENT"}


@dataclass(frozen=True)
class Job:
    """One target's share.

    Attributes:
        name: of the target.
        inputs: how many in all, over however many calls.
        folder: journal, kept inputs and findings of all targets.
        seed: of the mutations.
        most_s: seconds at most, of this call.
        targets: module that makes the targets, ``TARGETS``.
        marked: modules whose branches are marked.
        hang_s, more_mb: bounds of one input's time and of memory.
        deaths: so many ends of the process are enough.
    """

    name: str
    inputs: int
    folder: Path
    seed: int = 0
    most_s: float = 1e9
    targets: str = "tests.fuzz.targets"
    marked: Sequence[str] = ()
    hang_s: float = HANG_S
    more_mb: float = MORE_MB
    deaths: int = MOST_DEATHS

    @property
    def own(self) -> Path:
        """The target's folder."""
        return self.folder / self.name.replace(" ", "-")


def total(job: Job) -> dict[str, Any]:
    """What the journal says of a target so far."""
    path = job.own / "total.json"
    if path.exists():
        found: dict[str, Any] = json.loads(path.read_text())
        return found
    return {"name": job.name, "inputs": 0, "refused": 0, "kept": 0, "branches": 0, "reads": "",
            "seconds": 0.0, "more_mb": 0.0, "slowest_s": 0.0, "found": []}  # fmt: skip


def run(job: Job) -> dict[str, Any]:
    """Fuzz until the target has had its inputs; what was found is kept, one file an input."""
    for folder in ("kept", "found"):
        (job.own / folder).mkdir(parents=True, exist_ok=True)
    sofar = _added(job, total(job), _taken(job))  # of a guard that was killed
    deaths, end = 0, time.monotonic() + job.most_s
    while sofar["inputs"] < job.inputs and deaths < job.deaths and time.monotonic() < end:
        part, why, data = _once(job, job.inputs - sofar["inputs"], end - time.monotonic(), sofar)
        if why:
            deaths += 1
            part.setdefault("found", []).append([why, data.hex()])
        sofar = _added(job, sofar, part)
        if not why and not part.get("inputs"):
            break
    return sofar


def _once(
    job: Job, inputs: int, most_s: float, sofar: dict[str, Any]
) -> tuple[dict[str, Any], str, bytes]:
    """One process: its tally, and what it died of with the input it died of."""
    own = job.own
    (own / "now").unlink(missing_ok=True)
    now = Now(own / "now")
    words = {
        "targets": job.targets, "name": job.name, "inputs": inputs, "most_s": most_s,
        "seed": f"{job.seed}/{sofar['inputs']}", "folder": str(own), "marked": list(job.marked),
        "more_mb": job.more_mb, "step": STEP,
    }  # fmt: skip
    with (
        open(own / "stderr", "wb") as said,
        tempfile.TemporaryDirectory(
            prefix="fuzz", dir=FAST if os.path.isdir(FAST) else None, ignore_cleanup_errors=True
        ) as tmp,
    ):
        worker = subprocess.Popen(
            [sys.executable, "-m", "tests.fuzz.worker", json.dumps({**words, "tmp": tmp})],
            cwd=HOUSE, env={**os.environ, **QUIET}, stdout=said, stderr=said,
        )  # fmt: skip
        try:
            why = _watched(worker, now, job.hang_s)
        finally:
            worker.kill()
            worker.wait()
    part = _taken(job)
    if why:
        count, data = now.read()
        part["inputs"] = max(int(part.get("inputs", 0)), min(count, inputs))
        text = (own / "stderr").read_text(errors="replace")
        last = next((line for line in reversed(text.splitlines()) if line.strip()), "")
        return part, f"{why} ({last.strip()[:200]})", data
    more = part.get("peak_mb", 0.0) - part.get("before_mb", 0.0)
    if more > job.more_mb:
        part["found"].append([f"memory grew by {more:.0f} MB", ""])
    return part, "", b""


def _taken(job: Job) -> dict[str, Any]:
    """A worker's journal, taken away, so that nothing counts twice."""
    path = job.own / "tally.json"
    part: dict[str, Any] = json.loads(path.read_text()) if path.exists() else {}
    path.unlink(missing_ok=True)
    return part


def _watched(worker: subprocess.Popen[bytes], now: Now, hang_s: float) -> str:
    """Wait for its end; why it was no good one."""
    last, since, spent = 0, time.monotonic(), 0.0
    while True:
        try:
            code = worker.wait(0.5)
        except subprocess.TimeoutExpired:
            count, _ = now.read()
            cpu = _cpu_s(worker.pid)
            if count != last:
                last, since, spent = count, time.monotonic(), cpu
            asleep_s = hang_s * ASLEEP if count else START_S
            if (count and cpu - spent > hang_s) or time.monotonic() - since > asleep_s:
                worker.send_signal(signal.SIGABRT)  # it says where it stands
                worker.wait(10.0)
                return f"hang: longer than {hang_s:g} s"
            continue
        if code < 0:
            return f"crash: {signal.Signals(-code).name}"
        return f"crash: exit status {code}" if code else ""


def _cpu_s(pid: int) -> float:
    try:
        times = psutil.Process(pid).cpu_times()
    except psutil.Error:
        return 0.0
    return float(times.user + times.system)


def _added(job: Job, sofar: dict[str, Any], part: dict[str, Any]) -> dict[str, Any]:
    out = dict(sofar)
    for key in ("inputs", "refused", "kept", "seconds"):
        out[key] += part.get(key, 0)
    out["branches"] = max(out["branches"], part.get("branches", 0))
    out["reads"] = part.get("reads", out["reads"])
    out["slowest_s"] = max(out["slowest_s"], part.get("slowest_s", 0.0))
    out["more_mb"] = max(out["more_mb"], part.get("peak_mb", 0.0) - part.get("before_mb", 0.0))
    for what, data in part.get("found", []):
        path = job.own / "found" / f"{len(out['found'])}"
        path.write_bytes(bytes.fromhex(data))
        out["found"] = [*out["found"], what]
    partial = job.own / "total.partial"
    partial.write_text(json.dumps(out, indent=1))
    partial.replace(job.own / "total.json")
    return out
