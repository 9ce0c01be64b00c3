"""`python -m tests.overload`: runs in real time on a computer that is busy with other things.

Each run has a bench of its own in a process of its own. The bench stands for hardware, which no
load of a computer slows down; it gets a higher priority where the system grants it. Processes that
only count take the rest of the computer. The runs themselves get no privilege, unless
``--privileged`` says so.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import psutil

sys.path.insert(0, str(Path(__file__).resolve().parent))

from bench_process import BenchProcess, bench_process, worst_late_ms
from campaign_page import write_page
from daq.store.run import Run, open_run
from daq.store.verify import verify
from rigs.protocols.isometric import load_isometric
from rigs.rigfile.config import load_rig
from rigs.steps.schedule import outline

BENCH_PRIORITY = 10
UNPRIVILEGED = ("setpriv", "--bounding-set=-sys_nice")
COUNT = """
import os
parent = os.getppid()
while os.getppid() == parent:
    for _ in range(1_000_000):
        pass
"""
"""Ends with the program that started it, however that ends."""
MOST_LATE_S = 1800.0
"""A run that takes so much longer than planned is ended."""


@dataclass(frozen=True)
class OneRun:
    """How one run went."""

    outcome: str
    reason: str
    points: int
    planned_s: float
    duration_s: float
    bench_late_ms: float
    problems: int
    lateness: dict[str, Any]
    missing: int
    last_words: str
    delivery_ms: float = math.nan
    """Longest that a telemetry frame was under way from the controller to the program."""
    load: float = math.nan
    """Load average over the last five minutes, when the run had ended."""

    @property
    def silent(self) -> bool:
        """Whether the controller vented because it heard nothing of the host."""
        return "host_silent" in self.reason


def as_hardware(process: int) -> None:
    """Let no load delay a bench, as far as the system grants it."""
    for thread in psutil.Process(process).threads():
        with contextlib.suppress(OSError):
            os.sched_setscheduler(thread.id, os.SCHED_FIFO, os.sched_param(BENCH_PRIORITY))


@contextlib.contextmanager
def load(processes: int) -> Iterator[None]:
    """So many processes that only count; they are ended whatever happens."""
    busy = [subprocess.Popen([sys.executable, "-S", "-c", COUNT]) for _ in range(processes)]
    try:
        yield
    finally:
        for process in busy:
            process.kill()
        for process in busy:
            process.wait()


def protocol(folder: Path, minutes: float) -> tuple[Path, float]:
    """`isometric-short` with as many repeats as take so long; and how long that is, in s."""
    import configs

    text = (Path(configs.__file__).parent / "protocols" / "isometric-short.toml").read_text()
    config = load_rig("virtual")

    def written(repeats: int) -> tuple[Path, float]:
        path = folder / "overload.toml"
        path.write_text(text.replace("repeats = 1 ", f"repeats = {repeats} "))
        assert tomllib.loads(path.read_text())["repeats"] == repeats
        plan = load_isometric(str(path), config.limits)
        return path, outline(plan.steps(), config.stage.speed_mm_s)[1]

    one, two = written(1)[1], written(2)[1]
    return written(max(1, math.ceil((minutes * 60 - (2 * one - two)) / (two - one))))


def delivery_ms(run: Run) -> float:
    """Worst time from a sample to the arrival of its frame, in ms, by the clocks of the record.

    The kernel delivers the bytes of a pseudo-terminal in worker threads of ordinary priority, both
    ways: what arrives late from the simulated controller tells how late heartbeats reach it.
    """
    fits = [event for event in run.events if event["kind"] == "clockfit" and event["knots"]]
    if not fits:
        return math.nan
    device_us, host_ns = np.array(fits[-1]["knots"], dtype=np.float64).T
    rows = run.samples("valve")
    late_ns = np.asarray(rows["host_ns"]) - np.interp(rows["device_us"], device_us, host_ns)
    return float(late_ns[np.asarray(rows["device_us"]) <= device_us[-1]].max()) * 1e-6


def result(folder: Path, status: int, said: str, planned_s: float, late_ms: float) -> OneRun:
    """What the record of a run tells."""
    folders = [p.parent for p in (folder / "runs").glob("*/run.json")]
    last = (said.strip().splitlines() or [""])[-1]
    if not folders:
        return OneRun("refused", said, 0, planned_s, 0.0, late_ms, 0, {}, 0, last)
    run = open_run(folders[0])
    final = run.final or {}
    valve = (final.get("counters") or {}).get("valve") or {}
    return OneRun(
        run.outcome,
        str(final.get("reason", "")),
        sum(e["kind"] == "point" for e in run.events),
        planned_s,
        float(final.get("duration_s", 0.0)),
        late_ms,
        len(verify(run)),
        final.get("lateness") or {},
        int(valve.get("missing", -1)),
        f"status {status}: {last}",
        delivery_ms(run),
    )


def group(root: Path, runs: int, minutes: float, busy: int, privileged: bool) -> list[OneRun]:
    """So many runs side by side under the load."""
    with contextlib.ExitStack() as stack:
        benches: list[BenchProcess] = []
        for k in range(runs):
            bench = stack.enter_context(bench_process(root / str(k) / "bench"))
            as_hardware(bench.process.pid)
            benches.append(bench)
        path, planned_s = protocol(root, minutes)
        stack.enter_context(load(busy))
        before: tuple[str, ...] = ()
        if not privileged and os.geteuid() == 0 and shutil.which("setpriv"):
            before = UNPRIVILEGED
        clients = []
        for k, bench in enumerate(benches):
            words = [
                *before, sys.executable, "-m", "cli.main", "isometric", "--rig", str(bench.rig),
                "--protocol", str(path), "--out", str(root / str(k) / "runs"),
            ]  # fmt: skip
            out = stack.enter_context((root / str(k) / "said.txt").open("w"))
            clients.append(
                subprocess.Popen(words, stdin=subprocess.DEVNULL, stdout=out, stderr=out)
            )
        end = time.monotonic() + planned_s + MOST_LATE_S
        try:
            statuses = [c.wait(max(1.0, end - time.monotonic())) for c in clients]
        finally:
            for client in clients:
                if client.poll() is None:
                    client.kill()
                    client.wait()
        average = os.getloadavg()[1]
        late = [worst_late_ms(bench.stop()) for bench in benches]
    said = [(root / str(k) / "said.txt").read_text() for k in range(runs)]
    ended = [result(root / str(k), statuses[k], said[k], planned_s, late[k]) for k in range(runs)]
    return [replace(one, load=average) for one in ended]


def campaign(
    runs: int, side_by_side: int, minutes: float, busy: int, privileged: bool, folder: Path | None
) -> list[OneRun]:
    """All the runs, so many at a time; each is printed as it ends."""
    done: list[OneRun] = []
    with tempfile.TemporaryDirectory() as scratch:
        root = folder or Path(scratch)
        while len(done) < runs:
            n = min(side_by_side, runs - len(done))
            for one in group(root / f"group-{len(done)}", n, minutes, busy, privileged):
                done.append(one)
                print(json.dumps(vars(one)), flush=True)
    return done


PAGE = """# Runs on a busy computer

{runs} isometric tests in real time over pseudo-terminals, {side} side by side, while {busy}
processes take all the time they can get of a computer with {processors} processors. The shortest
test took {shortest_s:.0f} s. The load average over five minutes, at the end of each test, was
{load_low:.1f} to {load_high:.1f}. Each test has a simulated bench of its own, which stands for
hardware and therefore has a higher priority. The tests themselves {privilege}.
Measured on {date} with

    python -m tests.overload {options}

| | |
|---|---|
| tests that ended `host_silent` | {silent} |
| tests that ended clean | {clean} |
| samples missing | {missing} |
| heartbeat late, at most | {heartbeat_ms:.1f} ms, 99 % below {heartbeat_p99_ms:.1f} ms |
| ports read late, at most | {reading_ms:.1f} ms, 99 % below {reading_p99_ms:.1f} ms |
| bytes under way, at most | {delivery_ms:.0f} ms |
| program late, at most | {program_ms:.0f} ms, 99 % below {program_p99_ms:.0f} ms |
| priority granted | heartbeat {priority} |

A test ends `host_silent` when the controller vents because no heartbeat has come for 300 ms. A
heartbeat is sent every 100 ms, by a process of its own. Before there was this process, two of two
tests beside 8 such processes ended `host_silent` within 15 s. That is no strict comparison: the
benches then had a lower priority and were late themselves by up to 279 ms.

The columns *heartbeat*, *reading* and *program* state how late each of these threads was, at most;
*under way* is the longest time from a sample to the arrival of its frame. The kernel delivers the
bytes of a pseudo-terminal in threads of ordinary priority. A heartbeat to the simulated controller
waits for these threads, too; one to a real controller on USB does not.

| outcome | points | s | heartbeat (ms) | reading (ms) | program (ms) | under way (ms) | reason |
|---|---|---|---|---|---|---|---|
{rows}
"""


def page(done: list[OneRun], given: argparse.Namespace, begin: datetime) -> str:
    """What was measured, in Markdown."""

    def worst(loop: str, what: str) -> float:
        return max(float(one.lateness.get(loop, {}).get(what, 0.0)) for one in done)

    loops = ("heartbeat", "reading", "program")
    rows = []
    for one in done:
        late = " | ".join(str(one.lateness.get(loop, {}).get("max_ms", "")) for loop in loops)
        reason = re.sub(r"on \S+: ", "", one.reason)
        late += f" | {one.delivery_ms:.0f}"
        rows.append(f"| {one.outcome} | {one.points} | {one.duration_s:.0f} | {late} | {reason} |")
    granted = {str(one.lateness.get("priority", {}).get("heartbeat", "none")) for one in done}
    return PAGE.format(
        runs=len(done), side=given.side_by_side, busy=given.busy,
        shortest_s=min(one.duration_s for one in done),
        load_low=min(one.load for one in done), load_high=max(one.load for one in done),
        processors=os.cpu_count(), date=f"{begin:%Y-%m-%d}",
        privilege=f"were {'' if given.privileged else 'not '}allowed to raise their priority",
        options=f"--runs {given.runs} --side-by-side {given.side_by_side}"
        f" --minutes {given.minutes:g} --busy {given.busy}"
        + (" --privileged" if given.privileged else ""),
        silent=sum(one.silent for one in done),
        clean=sum(one.outcome == "clean" for one in done),
        missing=sum(max(0, one.missing) for one in done),
        priority=", ".join(sorted(granted)), rows="\n".join(rows),
        delivery_ms=max(one.delivery_ms for one in done),
        **{f"{loop}_ms": worst(loop, "max_ms") for loop in loops},
        **{f"{loop}_p99_ms": worst(loop, "p99_ms") for loop in loops},
    )  # fmt: skip


def main(argv: list[str] | None = None) -> int:
    """Run it; 1 where a run was silent or lost a sample."""
    parser = argparse.ArgumentParser(prog="python -m tests.overload", description=__doc__)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--side-by-side", type=int, default=2)
    parser.add_argument(
        "--minutes", type=float, default=7.0,
        help="as planned; a test on a simulated bench takes three quarters of it",
    )  # fmt: skip
    parser.add_argument("--busy", type=int, default=8)
    parser.add_argument("--privileged", action="store_true")
    parser.add_argument("--folder", type=Path, default=None, help="keep the records here")
    parser.add_argument("--page", type=Path, default=None)
    given = parser.parse_args(argv)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # everything that was started is ended
    begin = datetime.now(UTC)
    done = campaign(
        given.runs, given.side_by_side, given.minutes, given.busy, given.privileged, given.folder
    )
    silent = sum(one.silent for one in done)
    if given.page is not None:
        write_page(given.page, page(done, given, begin))
    print(
        f"{len(done)} runs of {min(one.duration_s for one in done):.0f} s and more beside"
        f" {given.busy} busy processes on {os.cpu_count()} processors,"
        f" {begin:%Y-%m-%d}: {silent} host_silent,"
        f" {sum(one.outcome == 'clean' for one in done)} clean"
    )
    return int(silent > 0 or any(one.outcome != "clean" for one in done))


if __name__ == "__main__":
    sys.exit(main())
