"""A served bench that was kept from the processor makes the time good as if it had not been."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from daq.clock import RealClock
from daq.link.codec import encode_request
from daq.link.transport import SerialLink
from rigs.devices.event_loop import EventLoop
from rigs.devices.valve_controller import ValveController
from rigs.rigfile.config import load_rig
from rigs.virtual.server import BenchServer, open_server

pytestmark = pytest.mark.realtime
STALL_S = 0.7
"""More than twice the heartbeat's deadline."""


@contextmanager
def armed_bench(folder: Path) -> Iterator[tuple[BenchServer, ValveController, EventLoop]]:
    """A bench on ports and a host that beats, run by one event loop."""
    clock = RealClock()
    event_loop = EventLoop(clock, 0.001)
    with open_server(load_rig("virtual"), folder) as server:
        event_loop.add(server.step)
        link = SerialLink(server.ports["valve"].address, 115200, clock)
        try:
            valve = ValveController(link, clock, event_loop)
            event_loop.add(valve.poll)
            valve.connect("VB-0001", "0.2")
            valve.progress(60.0)
            event_loop.for_seconds(0.2)
            valve.arm()
            event_loop.for_seconds(0.2)
            yield server, valve, event_loop
        finally:
            link.close()


def stall(valve: ValveController, clock: RealClock) -> None:
    """The host lives on for a while, the bench does not."""
    for _ in range(round(STALL_S / 0.01)):
        clock.sleep(0.01)
        valve.poll()


def test_a_host_that_beat_meanwhile_is_not_called_silent(tmp_path: Path) -> None:
    with armed_bench(tmp_path / "bench") as (server, valve, event_loop):
        stall(valve, RealClock())
        event_loop.for_seconds(0.3)
        assert list(server.bench.board.controller.safety.faults) == []
        assert valve.armed
        assert server.lateness_ms()["worst"] > 0.9e3 * STALL_S
        counters = valve.counters()
        assert counters["damaged"] == counters["missing"] == counters["duplicates"] == 0


def test_a_host_that_was_silent_meanwhile_is(tmp_path: Path) -> None:
    with armed_bench(tmp_path / "bench") as (server, valve, event_loop):
        valve.still()
        stall(valve, RealClock())
        event_loop.for_seconds(0.3)
        (fault,) = server.bench.board.controller.safety.faults
        assert "host_silent" in fault


@pytest.mark.parametrize("at", [0, 1, 40])
def test_a_request_cut_anywhere_is_heard_whole(tmp_path: Path, at: int) -> None:
    with armed_bench(tmp_path / "bench") as (_, valve, event_loop):
        valve.stop()  # parameters are set while disarmed
        data = encode_request(7, "set slew 91") + encode_request(8, "set slew 92")
        port = valve._link
        port.write(data[:at])
        event_loop.for_seconds(0.05)
        RealClock().sleep(0.1)
        port.write(data[at:])
        event_loop.for_seconds(0.1)
        assert valve.request("get slew")["slew"] == "92"
        assert valve.counters()["bad_payloads"] == 0
