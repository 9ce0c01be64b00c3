"""Links under every fault we could make: one LinkLost, in time, with name and remedy."""

from __future__ import annotations

import contextlib
import os
import socket
import sys
import threading
import time
from collections.abc import Iterator

import pytest

from daq.clock import RealClock, VirtualClock
from daq.errors import LinkLost, PortError
from daq.link.ports import READ_TIMEOUT_S
from daq.link.transport import Link, SerialLink, memory_pair

pty_only = pytest.mark.skipif(sys.platform == "win32", reason="no pseudo-terminals")


class Pty:
    """A pseudo-terminal: the device's end in hand, the host's end by path."""

    def __init__(self) -> None:
        import tty

        self.device, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.path = os.ttyname(self._slave)

    def send(self, data: bytes) -> None:
        os.write(self.device, data)

    def unplug(self) -> None:
        for name in ("device", "_slave"):
            if getattr(self, name) >= 0:
                os.close(getattr(self, name))
                setattr(self, name, -1)


@pytest.fixture
def pty() -> Iterator[Pty]:
    made = Pty()
    yield made
    made.unplug()


@pytest.fixture
def link(pty: Pty) -> Iterator[SerialLink]:
    opened = SerialLink(pty.path, 115200, RealClock())
    yield opened
    opened.close()


def received(link: Link, size: int, within_s: float = 30.0) -> bytes:
    data = b""
    end = time.monotonic() + within_s
    while len(data) < size and time.monotonic() < end:
        data += b"".join(chunk.data for chunk in link.read())
        time.sleep(0.002)
    return data


def received_late(pty: Pty, link: SerialLink) -> int:
    """How much older than the reading of it the stamp of a byte is, in ns."""
    pty.send(b"x")
    time.sleep(0.1)
    while not (chunks := link.read()):
        time.sleep(0.002)
    return time.monotonic_ns() - chunks[0].host_ns


def lost(link: Link, within_s: float = 30.0) -> LinkLost:
    end = time.monotonic() + within_s
    while time.monotonic() < end:
        try:
            link.read()
        except LinkLost as error:
            return error
        time.sleep(0.002)
    raise AssertionError("the link was never reported lost")


def keep_writing(link: Link, data: bytes, pause_s: float = 0.0) -> None:
    for _ in range(100):
        link.write(data)
        time.sleep(pause_s)


@pty_only
def test_bytes_go_both_ways_and_are_stamped_when_they_came(pty: Pty, link: SerialLink) -> None:
    before = time.monotonic_ns()
    pty.send(b"hello\x00\xff\n\r\x11\x13")
    assert received(link, 11) == b"hello\x00\xff\n\r\x11\x13"
    asked = time.monotonic_ns()
    pty.send(b"x")
    while not (chunks := link.read()):
        time.sleep(0.002)
    (chunk,) = chunks
    assert before < asked < chunk.host_ns < time.monotonic_ns()
    stamps = [received_late(pty, link) for _ in range(5)]
    assert max(stamps) > 50_000_000, "stamped when it was read, not when it came"
    link.write(b"\x01\x02\x00")
    assert os.read(pty.device, 10) == b"\x01\x02\x00"
    assert link.read() == []


@pty_only
def test_reading_never_blocks(link: SerialLink) -> None:
    start = time.perf_counter()
    for _ in range(100):
        assert link.read() == []
    assert time.perf_counter() - start < 50 * READ_TIMEOUT_S


@pty_only
def test_unplugged_while_reading(pty: Pty, link: SerialLink) -> None:
    pty.unplug()
    error = lost(link)
    assert error.where == pty.path
    assert error.remedy
    with pytest.raises(LinkLost):
        link.write(b"x")
    link.close()
    link.close()


@pty_only
def test_what_came_before_the_unplugging_is_still_read(pty: Pty, link: SerialLink) -> None:
    pty.send(b"last words")
    end = time.monotonic() + 30.0
    while link._inbox._held < 10 and time.monotonic() < end:  # a pty forgets when it is closed
        time.sleep(0.002)
    pty.unplug()
    time.sleep(0.15)
    assert received(link, 10) == b"last words"
    assert lost(link).where == pty.path


@pty_only
def test_unplugged_and_written_to_at_once(pty: Pty, link: SerialLink) -> None:
    pty.unplug()
    with pytest.raises(LinkLost) as caught:
        keep_writing(link, b"x", pause_s=0.01)
    assert pty.path in str(caught.value)


@pty_only
def test_a_device_that_takes_nothing_is_lost_not_waited_for(pty: Pty, link: SerialLink) -> None:
    start = time.perf_counter()
    with pytest.raises(LinkLost) as caught:
        keep_writing(link, bytes(4096))  # nobody reads the other end
    assert time.perf_counter() - start < 20.0
    assert "4096 bytes could not be sent" in str(caught.value)
    assert lost(link) is not None


@pty_only
def test_a_second_open_is_refused_here_and_in_another_process(pty: Pty, link: SerialLink) -> None:
    with pytest.raises(PortError) as caught:
        SerialLink(pty.path, 115200, RealClock())
    assert "in use" in str(caught.value)
    assert caught.value.where == pty.path
    link.close()
    again = SerialLink(pty.path, 115200, RealClock())
    again.close()


def test_a_missing_port_says_so_and_what_there_is() -> None:
    path = "COM99" if sys.platform == "win32" else "/dev/ttyNoSuchPort0"
    with pytest.raises(PortError) as caught:
        SerialLink(path, 115200, RealClock())
    assert "no such port" in str(caught.value)
    assert path in str(caught.value)


@pty_only
def test_a_file_that_is_no_port_is_refused(tmp_path: object) -> None:
    path = f"{tmp_path}/file"
    with open(path, "wb"):
        pass
    with pytest.raises(PortError) as caught:
        SerialLink(path, 115200, RealClock())
    assert path in str(caught.value)


def test_permission_refused_names_the_group(monkeypatch: pytest.MonkeyPatch) -> None:
    import serial

    def refuse(*_: object, **__: object) -> None:
        raise serial.SerialException(13, "could not open port /dev/ttyACM0: Permission denied")

    monkeypatch.setattr(serial, "serial_for_url", refuse)
    with pytest.raises(PortError, match="dialout"):
        SerialLink("/dev/ttyACM0", 115200, RealClock())


@pty_only
def test_every_way_a_port_can_fail_becomes_link_lost(
    pty: Pty, monkeypatch: pytest.MonkeyPatch
) -> None:
    import termios

    import serial

    for failure in (
        OSError(5, "Input/output error"),
        serial.SerialException("device reports readiness to read but returned no data"),
        termios.error(5, "Input/output error"),
        TypeError("'NoneType' object cannot be interpreted as an integer"),
    ):
        link = SerialLink(pty.path, 115200, RealClock())

        def fail(failure: Exception = failure) -> bytes:
            raise failure

        monkeypatch.setattr(link._port, "take", fail)
        assert str(failure) in str(lost(link))
        link.close()


@pty_only
def test_a_reader_that_does_not_come_costs_the_oldest_bytes_and_they_are_counted(pty: Pty) -> None:
    link = SerialLink(pty.path, 115200, RealClock(), buffer_bytes=1000)
    try:
        sent = b"".join(b"%03d " % k for k in range(500))
        for start in range(0, len(sent), 100):
            pty.send(sent[start : start + 100])
            time.sleep(0.003)
        end = time.monotonic() + 30.0
        while link.lost_bytes + link._inbox._held < len(sent) and time.monotonic() < end:
            time.sleep(0.002)
        data = b"".join(chunk.data for chunk in link.read())
        assert len(data) <= 1000
        assert sent.endswith(data)
        assert link.overruns > 0
        assert link.lost_bytes == len(sent) - len(data)
    finally:
        link.close()


@pty_only
def test_closing_while_another_thread_reads_and_writes(pty: Pty) -> None:
    link = SerialLink(pty.path, 115200, RealClock())
    unexpected: list[BaseException] = []
    stop = threading.Event()

    def use() -> None:
        try:
            while not stop.is_set():
                link.read()
                link.write(b"x")
                os.read(pty.device, 100)
        except LinkLost:
            pass
        except BaseException as error:
            unexpected.append(error)

    thread = threading.Thread(target=use)
    thread.start()
    time.sleep(0.1)
    link.close()
    stop.set()
    thread.join(30)
    assert not thread.is_alive()
    assert not unexpected
    assert not [t for t in threading.enumerate() if t.name == f"read {pty.path}"]


@pytest.fixture
def server() -> Iterator[socket.socket]:
    with socket.create_server(("127.0.0.1", 0)) as listening:
        yield listening


def test_a_socket_stands_in_where_there_is_no_pty(server: socket.socket) -> None:
    link = SerialLink(f"socket://127.0.0.1:{server.getsockname()[1]}", 115200, RealClock())
    with contextlib.closing(link):
        peer, _ = server.accept()
        with peer:
            peer.sendall(bytes(range(256)) * 100)
            assert received(link, 25600) == bytes(range(256)) * 100
            link.write(b"hello")
            assert peer.recv(10) == b"hello"
        assert "closed by the other end" in str(lost(link))


def test_a_socket_where_nothing_listens_and_a_wrong_address(server: socket.socket) -> None:
    port = server.getsockname()[1]
    server.close()
    with pytest.raises(PortError, match="nothing listens at this address"):
        SerialLink(f"socket://127.0.0.1:{port}", 115200, RealClock())
    with pytest.raises(PortError, match="not a port"):
        SerialLink("socket://nowhere", 115200, RealClock())


def test_memory_links_carry_bytes_at_the_clock_s_time() -> None:
    clock = VirtualClock()
    host, device = memory_pair(clock, "valve")
    host.write(b"id")
    clock.sleep(0.5)
    host.write(b"hb")
    assert [(c.host_ns, c.data) for c in device.read()] == [(0, b"id"), (500_000_000, b"hb")]
    device.write(b"ok")
    assert [c.data for c in host.read()] == [b"ok"]
    assert host.read() == []


def test_a_pulled_memory_cable_is_a_lost_link_on_both_ends() -> None:
    host, device = memory_pair(VirtualClock(), "valve")
    device.write(b"last words")
    device.unplug()
    assert [c.data for c in host.read()] == [b"last words"]
    with pytest.raises(LinkLost, match="valve"):
        host.read()
    with pytest.raises(LinkLost, match="valve"):
        host.write(b"x")
    with pytest.raises(LinkLost):
        device.write(b"x")
    host.close()
    host.close()
