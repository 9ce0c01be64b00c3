"""A viewer that is attacked, frozen or killed costs a real-time test nothing."""

from __future__ import annotations

import os
import re
import socket
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil
import pytest

from bench_process import (
    ATTEMPTS,
    LIMIT_S,
    bench_process,
    check_ended_well,
    gave_up,
    pamrig,
    run_folder,
    starved,
    worst_late_ms,
)
from daq.store.run import open_run
from daq.store.verify import verify
from door_attack import crowd, flood

pytestmark = pytest.mark.realtime
# A bench in a laboratory has its computer to itself; a test machine need not.
FULL = bool(os.environ.get("PAMRIG_CAMPAIGN"))
LATE_MS = 10.0 if FULL else None
CROWD, FLOOD = (10_000, 10_000) if FULL else (300, 100)


@contextmanager
def frozen_viewer(url: str) -> Iterator[None]:
    """Asks for the data of the live view, and never reads a byte of them."""
    port, path = re.fullmatch(r"http://127\.0\.0\.1:(\d+)(/.*)", url).groups()
    with socket.create_connection(("127.0.0.1", int(port)), timeout=60) as s:
        s.sendall(f"GET {path}view.rrd HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".encode())
        yield


def attacked(url: str) -> None:
    """A crowd that says nothing, and beside it a flood of strangers, for some seconds."""
    port = int(url.split(":")[2].split("/")[0])
    with crowd(port, CROWD):
        seen = flood(port, FLOOD, limit_s=60.0)  # at most until the run has ended
    assert seen.connections >= 100
    assert seen.content == 0
    assert set(seen.statuses) <= {"400", "403", "none"}
    print(f"\n{CROWD} idle connections, {seen.connections} requests: {seen.statuses}")


def viewer_of(client: subprocess.Popen[str]) -> psutil.Process:
    """The viewer's process of a run."""
    children = psutil.Process(client.pid).children()
    (found,) = (child for child in children if "daq.live.screen" in child.cmdline())
    return found


def watched(place: Path, viewer: str) -> tuple[int, str, str, str]:
    """One run with a viewer: status, what it said, what it told, the bench's last words."""
    with bench_process(place / "bench") as bench:
        client = pamrig(
            "isometric", "--rig", bench.rig, "--protocol", "isometric-short",
            "--out", place / "runs", "--live", "--no-browser",
        )  # fmt: skip
        assert client.stderr is not None
        line = client.stderr.readline()
        while "live view" not in line:
            assert line, client.communicate()
            line = client.stderr.readline()
        found = re.search(r"http://127\.0\.0\.1:\d+/[\w-]{40,}/", line)
        assert found, line
        if viewer == "killed":
            time.sleep(3)
            viewer_of(client).kill()
            said, told = client.communicate(timeout=LIMIT_S)
            assert told.count("the viewer's process ended") == 1, told
        elif viewer == "attacked":
            time.sleep(2)
            attacked(found[0])
            said, told = client.communicate(timeout=LIMIT_S)
        else:
            with frozen_viewer(found[0]):
                time.sleep(2)
                viewer_of(client).suspend()
                said, told = client.communicate(timeout=LIMIT_S)
        return client.returncode, said, told, bench.stop()


@pytest.mark.parametrize("viewer", ["attacked", "frozen", "killed"])
def test_not_one_sample_is_lost(tmp_path: Path, viewer: str) -> None:
    late_ms: list[float] = []
    for attempt in range(ATTEMPTS):
        place = tmp_path / str(attempt)
        status, said, told, words = watched(place, viewer)
        late_ms.append(worst_late_ms(words))
        if not starved(status, said, late_ms[-1]):
            break
        check_ended_well(place / "runs")
    else:
        raise gave_up(said + told, late_ms)
    assert status == 0, (said, told)
    run = open_run(run_folder(place / "runs"))
    assert run.outcome == "clean"
    assert verify(run) == []
    counters = run.manifest and run.final and run.final["counters"]["valve"]
    assert counters["missing"] == counters["damaged"] == counters["duplicates"] == 0
    seq = run.samples("valve")["seq"]
    assert len(seq) == seq[-1] - seq[0] + 1
    late = re.search(r"p99\.9 ([\d.]+) ms", words)
    assert late
    print(f"\n{viewer}: {len(seq)} samples, loop lateness {words.splitlines()[-1]}")
    if LATE_MS is not None:
        assert float(late[1]) < LATE_MS
