"""A viewer that is absent, frozen or killed costs a real-time test nothing."""

from __future__ import annotations

import os
import re
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

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

pytestmark = pytest.mark.realtime
# A bench in a laboratory has its computer to itself; a test machine need not.
LATE_MS = 10.0 if os.environ.get("PAMRIG_CAMPAIGN") else None


@contextmanager
def frozen_viewer(port: int) -> Iterator[None]:
    """Connects to the live view's server and never reads a byte."""
    with socket.create_connection(("127.0.0.1", port), timeout=60) as s:
        # The beginning of an HTTP/2 connection, as a viewer sends it.
        s.sendall(b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + bytes.fromhex("000000040000000000"))
        yield


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
        found = re.search(r"127\.0\.0\.1:(\d+)", line)
        assert found, line
        port = int(found[1])
        if viewer == "absent":
            said, told = client.communicate(timeout=LIMIT_S)
        else:
            with frozen_viewer(port):
                if viewer == "killed":
                    time.sleep(3)
                else:
                    said, told = client.communicate(timeout=LIMIT_S)
            if viewer == "killed":
                said, told = client.communicate(timeout=LIMIT_S)
        return client.returncode, said, told, bench.stop()


@pytest.mark.parametrize("viewer", ["absent", "frozen", "killed"])
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
