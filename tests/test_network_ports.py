"""Serial ports of a server: RFC 2217 and raw TCP, against real servers of both."""

from __future__ import annotations

import contextlib
import socket
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from bench_process import bench_process, call_pamrig, run_folder, run_pamrig
from daq.clock import RealClock
from daq.errors import LinkLost, PortError
from daq.link.acquisition import Acquisition
from daq.link.transport import SerialLink
from daq.store.run import open_run
from rigs.devices.event_loop import EventLoop
from rigs.devices.valve_controller import ValveController
from rigs.rigfile.config import load_rig
from rigs.virtual.server import open_server
from serial_servers import SerialServer
from test_daq_transport import lost, pty_only, received

EVERY_BYTE = bytes(range(256)) * 4
KINDS = ["rfc2217", "socket"]
SILENT_S = 0.350


@contextlib.contextmanager
def served(kind: str, path: str = "loop://") -> Iterator[SerialServer]:
    server = SerialServer(path, kind == "rfc2217")
    try:
        yield server
    finally:
        server.close()


@pytest.mark.parametrize("own_process", [False, True])
@pytest.mark.parametrize("kind", KINDS)
def test_every_byte_goes_both_ways(kind: str, own_process: bool) -> None:
    with contextlib.ExitStack() as stack:
        server = stack.enter_context(served(kind))
        acquisition = None
        if own_process:
            acquisition = Acquisition()
            stack.callback(acquisition.close)
        link = SerialLink(server.address, 57600, RealClock(), acquisition=acquisition)
        with contextlib.closing(link):
            before_ns = time.monotonic_ns()
            link.write(EVERY_BYTE)
            assert received(link, len(EVERY_BYTE)) == EVERY_BYTE
            link.write(b"x")
            while not (chunks := link.read()):
                time.sleep(0.002)
            assert before_ns < chunks[0].host_ns < time.monotonic_ns()
            assert link.beats is (own_process and kind == "socket")


def test_the_baud_rate_reaches_the_port_of_the_server() -> None:
    with served("rfc2217") as server:
        SerialLink(server.address, 57600, RealClock()).close()
        assert server.serial.baudrate == 57600


@pytest.mark.parametrize("kind", KINDS)
def test_a_connection_that_ends_is_a_lost_link(kind: str) -> None:
    with served(kind) as server:
        link = SerialLink(server.address, 9600, RealClock())
        with contextlib.closing(link):
            link.write(b"x")
            assert received(link, 1) == b"x"  # now it is certain that the server has the client
            server.cut()
            error = lost(link)
            assert error.where == server.address
            assert error.remedy
            with pytest.raises(LinkLost):
                link.write(b"x")


@pytest.mark.realtime
def test_a_server_that_takes_nothing_is_lost_not_waited_for() -> None:
    with served("rfc2217") as server:
        server.serial.write = lambda data: time.sleep(3.0)
        link = SerialLink(server.address, 9600, RealClock())
        with contextlib.closing(link):
            begin = time.monotonic()
            with pytest.raises(LinkLost):
                write_much(link)
            assert time.monotonic() - begin < 2.5, "pyserial would wait 5 s for each write"


def write_much(link: SerialLink) -> None:
    for _ in range(1000):
        link.write(bytes(65536))


def closed_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as listening:
        return int(listening.getsockname()[1])


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("rfc2217://127.0.0.1", "expected rfc2217://host:port"),
        ("rfc2217://127.0.0.1:ttyUSB0", "expected rfc2217://host:port"),
        ("rfc2217://127.0.0.1:99999", "expected rfc2217://host:port"),
        ("socket://:4001", "expected socket://host:port"),
        ("telnet://127.0.0.1:23", "unknown kind 'telnet'"),
        ("loop://", "unknown kind 'loop'"),
        ("rfc2217://127.0.0.1:CLOSED", "nothing listens at this address"),
        ("socket://127.0.0.1:CLOSED", "nothing listens at this address"),
    ],
)
def test_a_wrong_name_is_one_line_and_status_2(tmp_path: Path, name: str, words: str) -> None:
    name = name.replace("CLOSED", str(closed_port()))
    with pytest.raises(PortError, match=words) as caught:
        SerialLink(name, 9600, RealClock())
    assert "\n" not in str(caught.value)
    rig = tmp_path / "rig.toml"
    text = load_rig("virtual").text.replace('port = "virtual"', f'port = "{name}"')
    rig.write_text(text.replace('source = "virtual"', 'source = "uvc:0"'))
    done = call_pamrig("vent", "--rig", rig)
    assert done.returncode == 2
    (line,) = done.stderr.strip().splitlines()
    assert words in line
    assert "valve.port" in line


def test_a_server_of_raw_bytes_is_not_taken_for_one_of_rfc_2217() -> None:
    with served("socket") as server:
        name = server.address.replace("socket", "rfc2217") + "?timeout=0.3"
        with pytest.raises(PortError, match=r"does not speak RFC 2217.*socket://"):
            SerialLink(name, 9600, RealClock())


@pty_only
@pytest.mark.realtime
@pytest.mark.parametrize("kind", KINDS)
def test_a_connection_cut_while_armed_vents_the_muscle(tmp_path: Path, kind: str) -> None:
    clock = RealClock()
    event_loop = EventLoop(clock, 0.001)
    with contextlib.ExitStack() as stack:
        bench = stack.enter_context(open_server(load_rig("virtual"), tmp_path))
        event_loop.add(bench.step)
        server = stack.enter_context(served(kind, bench.ports["valve"].address))
        link = SerialLink(server.address, 115200, clock)
        stack.callback(link.close)
        valve = ValveController(link, clock, event_loop)
        event_loop.add(valve.poll)
        valve.connect("VB-0001", "0.2")
        valve.progress(60.0)
        event_loop.for_seconds(0.2)
        valve.arm()
        valve.request("scheme burst")
        valve.set_point(1000)
        assert event_loop.until(lambda: bench.bench.board.pressure_kpa > 150.0, 20.0)
        assert not valve.faults
        cut_ns = clock.now_ns()
        server.cut()
        with pytest.raises(LinkLost, match=server.address):
            event_loop.for_seconds(5.0)
        event_loop.remove(valve.poll)
        board = bench.bench.board
        assert event_loop.until(lambda: bool(board.controller.safety.faults), 5.0)
        (fault,) = board.controller.safety.faults
        assert "host_silent" in fault
        assert bench.bench.host_ns(board.vent_commanded_us * 1000) - cut_ns <= SILENT_S * 1e9
        assert event_loop.until(lambda: board.pressure_kpa < 20.0, 5.0)


@pytest.mark.campaign
@pytest.mark.realtime
@pytest.mark.parametrize("kind", KINDS)
def test_a_whole_run_over_a_server(tmp_path: Path, kind: str) -> None:
    with bench_process(tmp_path / "bench") as bench, contextlib.ExitStack() as stack:
        text = bench.rig.read_text()
        for name in ("valve", "balance", "stage"):
            path = tmp_path / "bench" / name
            text = text.replace(str(path), stack.enter_context(served(kind, str(path))).address)
        rig = tmp_path / "network.toml"
        rig.write_text(text)
        words = ("isometric", "--rig", rig, "--protocol", "isometric-short", "--out")
        done = run_pamrig(*words, tmp_path / "runs")
        assert done.returncode == 0, done.stderr
        run = open_run(run_folder(tmp_path / "runs"))
        assert run.outcome == "clean"
        assert run.final is not None
        assert run.final["counters"]["valve"]["missing"] == 0
