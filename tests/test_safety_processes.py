"""Real processes, a real port, real time: the host is stopped dead, or talks rubbish.

The bench runs in a process of its own and writes its truth down; a small host arms it, fills the
muscle and beats. Times are the bench's: from the last heartbeat that reached it.
"""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from bench_process import bench_process

SILENT_S = 0.350
EMPTY_S = {"virtual": 1.5, "virtual-thesis": 0.3}
EMPTY_KPA = 20.0

HOST = """
import sys
from rigs.config import load_rig
from rigs.rig import open_valve
config = load_rig(sys.argv[1])
with open_valve(config) as (valve, pump, _, _bench):
    valve.configure(config.valve.parameters)
    valve.progress(60.0)
    valve.arm()
    valve.request("scheme %s")
    valve.set_point(%d)
    pump.for_seconds(1.5)
    print("ready", flush=True)
    pump.for_seconds(60.0)
"""


@pytest.mark.skipif(os.name == "nt", reason="signals and pseudo-terminals")
@pytest.mark.parametrize("rig", ["virtual"])
@pytest.mark.parametrize("how", ["stopped", "garbage"])
def test_the_muscle_is_vented(tmp_path: Path, rig: str, how: str) -> None:
    with bench_process(tmp_path / "bench", rig) as bench:
        host = subprocess.Popen(
            [sys.executable, "-c", HOST % ("burst", 2000), str(bench.rig)],
            stdout=subprocess.PIPE,
            text=True,
        )
        assert host.stdout is not None
        try:
            assert host.stdout.readline() == "ready\n"
            high_kpa = bench.truth()[-1]["pressure_kpa"]
            os.kill(host.pid, signal.SIGSTOP)
            if how == "garbage":
                rng = random.Random(1)
                with (tmp_path / "bench" / "valve").open("wb", buffering=0) as port:
                    end = time.monotonic() + SILENT_S + EMPTY_S[rig] + 0.5
                    while time.monotonic() < end:
                        port.write(rng.randbytes(115))
                        time.sleep(0.01)
            else:
                time.sleep(SILENT_S + EMPTY_S[rig] + 0.5)
        finally:
            host.kill()
            host.wait(10)
            host.stdout.close()
        truth = bench.truth()
    assert high_kpa > 400
    faulted = [line for line in truth if line["faults"]]
    assert "host_silent" in faulted[0]["faults"][0]
    commanded_ns = faulted[0]["vent_commanded_ns"]
    last_ns = max(line["last_heartbeat_ns"] for line in truth)
    assert (commanded_ns - last_ns) * 1e-9 <= SILENT_S
    late = [t for t in truth if t["t_ns"] >= commanded_ns + EMPTY_S[rig] * 1e9]
    assert late
    assert max(t["pressure_kpa"] for t in late) < EMPTY_KPA
