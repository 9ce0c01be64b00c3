"""Real processes, a real port, real time: the host is stopped dead, or talks rubbish.

The bench runs in a process of its own and writes its truth down; a small host arms it, fills the
muscle and beats. Times are the bench's: from the last heartbeat that reached it. A host that is
stopped dead has a process that goes on beating for at most the second that was granted.
"""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from bench_process import ATTEMPTS, bench_process, pamrig, run_folder, run_pamrig
from daq.store.run import open_run
from rigs.devices.valve_controller import ALIVE_S

SILENT_S = 0.350
LATE_S = 0.15
"""The bench, too, is a process that waits for its turn."""
EMPTY_S = {"virtual": 1.5, "virtual-thesis": 0.3}
EMPTY_KPA = 20.0

HOST = """
import sys
from rigs.rigfile.config import load_rig
from rigs.bench.rig import open_valve
config = load_rig(sys.argv[1])
with open_valve(config) as (valve, event_loop, _, _bench):
    valve.configure(config.valve.parameters)
    valve.progress(60.0)
    valve.arm()
    valve.request("scheme %s")
    valve.set_point(%d)
    event_loop.until(lambda: valve.recent_counts(50).mean() > 1800 or valve.faults, 30.0)
    print(*valve.faults or ["ready"], flush=True)
    event_loop.for_seconds(60.0)
"""


@pytest.mark.realtime
@pytest.mark.skipif(os.name == "nt", reason="signals and pseudo-terminals")
@pytest.mark.parametrize("rig", ["virtual"])
@pytest.mark.parametrize("how", ["stopped", "garbage"])
def test_the_muscle_is_vented(tmp_path: Path, rig: str, how: str) -> None:
    for attempt in range(ATTEMPTS):
        truth = without_its_host(tmp_path / str(attempt), rig, how)
        if truth:
            break
    assert truth, "the host was never given the processor for long enough to fill the muscle"
    faulted = [line for line in truth if line["faults"]]
    assert "host_silent" in faulted[0]["faults"][0]
    commanded_ns = faulted[0]["vent_commanded_ns"]
    assert max(line["pressure_kpa"] for line in truth if line["t_ns"] < commanded_ns) > 400
    last_ns = max(line["last_heartbeat_ns"] for line in truth)
    assert (commanded_ns - last_ns) * 1e-9 <= SILENT_S
    late = [t for t in truth if t["t_ns"] >= commanded_ns + EMPTY_S[rig] * 1e9]
    assert late
    assert max(t["pressure_kpa"] for t in late) < EMPTY_KPA


def without_its_host(folder: Path, rig: str, how: str) -> list[dict[str, Any]]:
    """The bench's truth around the moment the host was stopped; empty where it never got going."""
    with bench_process(folder / "bench", rig) as bench:
        host = subprocess.Popen(
            [sys.executable, "-c", HOST % ("burst", 2000), str(bench.rig)],
            stdout=subprocess.PIPE,
            text=True,
        )
        assert host.stdout is not None
        try:
            said = host.stdout.readline()
            if "host_silent" in said:
                return []
            assert said == "ready\n"
            os.kill(host.pid, signal.SIGSTOP)
            stopped_ns = time.monotonic_ns()
            end_ns = stopped_ns + round((ALIVE_S + SILENT_S + EMPTY_S[rig] + 0.5) * 1e9)
            rng = random.Random(1)
            with (folder / "bench" / "valve").open("wb", buffering=0) as port:
                # The bench may lag behind the wall clock; its own time is what counts.
                while time.monotonic_ns() < end_ns or bench.lately()[-1]["t_ns"] < end_ns:
                    if how == "garbage":
                        port.write(rng.randbytes(115))
                    time.sleep(0.01)
            truth = bench.truth()
            last_ns = max(line["last_heartbeat_ns"] for line in truth)
            assert (last_ns - stopped_ns) * 1e-9 <= ALIVE_S + LATE_S
            return truth
        finally:
            host.kill()
            host.wait()
            host.stdout.close()


@pytest.mark.realtime
def test_vent_at_any_time_also_while_a_test_holds_the_rig(tmp_path: Path) -> None:
    """The port was held by the test, and `pamrig vent` was refused."""
    with bench_process(tmp_path / "bench") as bench:
        words = ("isometric", "--rig", bench.rig, "--protocol", "isometric-short", "--out")
        client = pamrig(*words, tmp_path / "runs", stdin=subprocess.DEVNULL)
        end = time.monotonic() + 120
        while not any(
            b'"kind":"armed"' in path.read_bytes()
            for path in (tmp_path / "runs").glob("*/events.jsonl")
        ):
            assert time.monotonic() < end
            assert client.poll() is None, client.communicate()
            time.sleep(0.1)
        done = run_pamrig("vent", "--rig", bench.rig, limit_s=120)
        _, said = client.communicate(timeout=120)
        assert done.returncode == 0, done.stderr
        assert "asked it to end and vent" in done.stderr
        assert "vented and disarmed" in done.stdout
        assert client.returncode == 130, said
        run = open_run(run_folder(tmp_path / "runs"))
        assert run.outcome == "stopped"
        assert [e for e in run.events if e["kind"] == "vented"]
