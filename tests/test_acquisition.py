"""Ports and heartbeat in a process of their own: late programs, dead programs, busy computers."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import psutil
import pytest

from bench_process import LIMIT_S, BenchProcess, bench_process, pamrig, run_folder
from daq.clock import RealClock
from daq.errors import LinkLost
from daq.link.acquisition import Acquisition, available
from daq.link.lateness import Lateness
from daq.link.transport import SerialLink
from rigs.bench.computer import Computer, raised_priority
from rigs.bench.doctor import computer_finding
from rigs.bench.rig import open_valve
from rigs.devices.event_loop import EventLoop
from rigs.devices.valve_controller import ALIVE_S, ValveController
from rigs.rigfile.config import load_rig
from test_daq_transport import Pty, lost, received

pytestmark = pytest.mark.skipif(not available(), reason="no port can be handed to a process")
SILENT_S = 0.350
ROUND_S = 0.2
"""A frame every 0.1 s may just have been sent, and the truth is written every 10 ms."""


@pytest.fixture
def acquisition() -> Iterator[Acquisition]:
    made = Acquisition()
    yield made
    made.close()


@pytest.fixture
def pty() -> Iterator[Pty]:
    made = Pty()
    yield made
    made.unplug()


def linked(pty: Pty, acquisition: Acquisition) -> SerialLink:
    return SerialLink(pty.path, 115200, RealClock(), acquisition=acquisition)


# ---- the process ------------------------------------------------------------------------


def test_bytes_are_stamped_when_they_come_while_the_program_is_late(
    pty: Pty, acquisition: Acquisition
) -> None:
    with contextlib.closing(linked(pty, acquisition)) as link:
        pty.send(b"x")
        sent_ns = time.monotonic_ns()
        busy_until = time.monotonic() + 0.4
        while time.monotonic() < busy_until:
            sum(range(200_000))  # one call of C after another, each with the interpreter's lock
        assert received(link, 0) == b""
        chunks = link.read()
        assert b"".join(c.data for c in chunks) == b"x"
        assert abs(chunks[0].host_ns - sent_ns) < 100_000_000


def test_ports_come_and_go_and_can_be_opened_again(pty: Pty, acquisition: Acquisition) -> None:
    for _ in range(3):
        with contextlib.closing(linked(pty, acquisition)) as link:
            pty.send(b"abc")
            assert received(link, 3) == b"abc"
            link.write(b"x")
            assert os.read(pty.device, 10) == b"x"


def test_unplugged_and_ended_processes_are_lost_links(acquisition: Acquisition) -> None:
    first, second = Pty(), Pty()
    with (
        contextlib.closing(linked(first, acquisition)) as one,
        contextlib.closing(linked(second, acquisition)) as two,
    ):
        first.unplug()
        assert lost(one).where == first.path
        second.send(b"still here")
        assert received(two, 10) == b"still here"
        acquisition._process.kill()
        assert "process that reads the ports" in str(lost(two))
        with pytest.raises(LinkLost):
            two.write(b"x")
    second.unplug()


def test_the_process_ends_with_a_program_that_is_killed() -> None:
    text = (
        "import time; from daq.link.acquisition import Acquisition;"
        "a = Acquisition(); print(a._process.pid, flush=True); time.sleep(60)"
    )
    with subprocess.Popen(
        [sys.executable, "-c", text], stdout=subprocess.PIPE, text=True
    ) as program:
        assert program.stdout is not None
        process = psutil.Process(int(program.stdout.readline()))
        program.send_signal(signal.SIGKILL)
        process.wait(5.0)


def test_half_a_frame_is_never_sent_and_none_after_the_time_is_over(
    pty: Pty, acquisition: Acquisition
) -> None:
    with contextlib.closing(linked(pty, acquisition)) as link:
        link.queue_beats(20_000_000, [(k, b"beat %02d|" % k) for k in range(40)])
        until_ns = time.monotonic_ns() + 300_000_000
        link.keep_alive(until_ns)
        time.sleep(0.6)
        beats = link.take_beats()
        frames = os.read(pty.device, 1000).split(b"|")[:-1]
        assert frames == [b"beat %02d" % k for k, _ in beats]
        assert 3 <= len(beats) <= 16
        assert max(sent_ns for _, sent_ns in beats) < until_ns + 50_000_000


# ---- with the firmware ------------------------------------------------------------------


@contextlib.contextmanager
def armed(folder: Path) -> Iterator[tuple[BenchProcess, ValveController, EventLoop]]:
    with bench_process(folder) as bench, open_valve(load_rig(str(bench.rig))) as opened:
        valve, event_loop, _, _ = opened
        valve.progress(60.0)
        event_loop.for_seconds(0.3)
        valve.arm()
        event_loop.for_seconds(0.3)
        yield bench, valve, event_loop


@pytest.mark.realtime
def test_a_program_late_by_twice_the_limit_is_not_silent_and_one_that_hangs_is(
    tmp_path: Path,
) -> None:
    """Before, the loop that carries the test out beat as well: 0.3 s of it vented the muscle."""
    with armed(tmp_path) as (bench, valve, event_loop):
        time.sleep(0.7)
        event_loop.for_seconds(0.3)
        assert list(valve.faults) == []
        assert valve.armed
        assert valve.clock_fit.pings >= 10
        hung_ns = time.monotonic_ns()
        time.sleep(ALIVE_S + SILENT_S + 0.5)
        event_loop.for_seconds(0.2)
        assert "host_silent" in valve.faults[0]
        vented = [t["vent_commanded_ns"] for t in bench.truth() if t["faults"]]
        assert (vented[0] - hung_ns) * 1e-9 < ALIVE_S + SILENT_S + ROUND_S


@pytest.mark.realtime
def test_a_computer_without_time_is_named_as_such_and_by_how_much(tmp_path: Path) -> None:
    """Cable and power were suspected before."""
    with bench_process(tmp_path / "bench") as bench:
        words = ("isometric", "--rig", bench.rig, "--protocol", "isometric-short", "--out")
        client = pamrig(*words, tmp_path / "runs", stdin=subprocess.DEVNULL)
        end = time.monotonic() + LIMIT_S
        while not any(
            b'"kind":"armed"' in path.read_bytes()
            for path in (tmp_path / "runs").glob("*/events.jsonl")
        ):
            assert client.poll() is None, client.communicate()
            assert time.monotonic() < end
            time.sleep(0.02)
        children = psutil.Process(client.pid).children()
        (process,) = (c for c in children if "port_process" in " ".join(c.cmdline()))
        process.suspend()
        time.sleep(0.6)
        process.resume()
        said, told = client.communicate(timeout=LIMIT_S)
        assert client.returncode == 2, said + told
    final = open_final(tmp_path / "runs")
    for text in (said, str(final["reason"])):
        assert "host_silent" in text
        assert "the computer was too busy: the heartbeat was late by up to" in text
        assert "the controller waits 300 ms" in text
        assert "cable" not in text
    assert final["lateness"]["heartbeat"]["max_ms"] > 500
    assert final["lateness"]["heartbeat_limit_ms"] == 300


def open_final(runs: Path) -> dict[str, dict[str, dict[str, float]]]:
    final: dict[str, dict[str, dict[str, float]]] = json.loads(
        (run_folder(runs) / "final.json").read_text()
    )
    return final


# ---- lateness ---------------------------------------------------------------------------


def test_the_classes_give_the_quantile_to_12_percent() -> None:
    late_s = np.random.default_rng(1).lognormal(np.log(2e-3), 1.5, 20_000)
    lateness = Lateness()
    lateness.extend(float(x) for x in late_s)
    assert lateness.max_s == late_s.max()
    for share in (0.5, 0.99, 0.999):
        exact = float(np.quantile(late_s, share, method="inverted_cdf"))
        assert exact <= lateness.quantile_s(share) <= exact * 1.13
    assert lateness.as_dict()["rounds"] == 20_000
    assert Lateness().as_dict() == {"rounds": 0, "max_ms": 0.0, "p99_ms": 0.0}


def test_the_priority_is_raised_while_it_is_needed_and_given_back() -> None:
    def now() -> tuple[int, int]:
        return os.sched_getscheduler(0), os.getpriority(os.PRIO_PROCESS, 0)

    before = now()
    with raised_priority() as granted:
        assert (now() == before) is (granted == "normal")
    assert now() == before


class SlowClock(RealClock):
    """A computer that gives the program its turn this much too late."""

    late_s = 0.0

    def sleep(self, seconds: float) -> None:
        super().sleep(seconds + self.late_s)


def test_a_late_computer_is_measured_and_judged_against_the_heartbeat_limit() -> None:
    clock = SlowClock()
    event_loop = EventLoop(clock, 0.002)
    computer = Computer(event_loop, load_rig("virtual"))
    for status, late_s in (("ok", 0.0), ("warn", 0.08), ("stop", 0.25)):
        clock.late_s = late_s
        event_loop.step()
        event_loop.step()
        finding = computer_finding(computer)
        assert finding.status == status, finding
        assert "the heartbeat limit is 300 ms" in finding.detail
        assert computer.program.max_s >= late_s
        assert bool(computer.busy()) is (late_s > 0.0)
    computer.look()
    computer._restart_ns = 0
    computer.look()
    assert computer.busy() == "", "what is long ago explains no fault"


def test_what_came_while_the_program_had_no_turn_is_read_before_a_deadline_counts() -> None:
    clock = SlowClock()
    event_loop = EventLoop(clock, 0.002)
    event_loop.step()
    rounds: list[int] = []
    event_loop.add(lambda: rounds.append(len(rounds)))
    clock.late_s = 0.1
    assert event_loop.until(lambda: len(rounds) >= 3, 0.05)
    clock.late_s = 0.0
    assert not event_loop.until(lambda: False, 0.01)
